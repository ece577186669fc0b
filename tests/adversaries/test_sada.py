from sada_gym.adversaries.level_set import SADA
from sada_gym.testing import AdversaryContract


class TestSADA(AdversaryContract):
    uses_values = True
    budget = 100

    def make(self, dimension, seed):
        return SADA(dimension, seed=seed, rounds=1, models=["trees"])
