import json

import pytest

from sada_gym.adversaries.random import Random
from sada_gym.testing import AdversaryContract


class TestRandom(AdversaryContract):
    def make(self, dimension, seed):
        return Random(dimension, seed=seed)

    def test_spends_nothing_and_is_uniform(self):
        adversary, oracle = self.train()
        assert oracle.remaining == self.budget
        samples = adversary.sample(20_000)
        assert abs(samples.mean()) < 0.02
        assert abs(samples.std() - 3**-0.5) < 0.01

    def test_a_broken_file_is_refused(self, tmp_path):
        for text in ("{", json.dumps({"dimension": 2})):
            (tmp_path / "adversary.json").write_text(text)
            with pytest.raises(ValueError, match=r"Expected a folder that `Random.save` wrote"):
                Random.load(tmp_path)
