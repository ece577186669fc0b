"""Files that a user hands over never run code, and bad ones are refused in a sentence."""

import io
import json
import pickle
import struct
import zipfile

import numpy as np
import pytest
import torch
from quick import QUICK

from sada_gym import adversaries, agents
from sada_gym.errors import UserError
from studies.landscapes import FunctionOracle

# SADA-Pixel's are those of SADA-Digits
APPLICATIONS = ["SADA-Detection", "SADA-Driving", "SADA-UAV", "SADA-Digits"]


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return open, (self.marker, "w")


def zipped(name, content):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr(name, content)
    return buffer.getvalue()


def saved(save, what):
    buffer = io.BytesIO()
    save(buffer, what)
    return buffer.getvalue()


def safetensors(header, body=b""):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + body


def hostile_files(marker, good):
    """What somebody might put in the place of a file of weights, by name."""
    payload = Payload(marker)
    pickled = pickle.dumps(payload)
    objects = np.array([payload], dtype=object)
    tensor = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}
    return {
        "a pickle": pickled,
        "an old pickle": pickle.dumps(payload, protocol=0),
        "torch.save": saved(lambda file, what: torch.save(what, file), {"weights": payload}),
        "an SB3 zip": zipped("data", json.dumps({"policy_class": {":serialized:": "gASV"}})),
        "a zip with a pickle": zipped("archive/data.pkl", pickled),
        "an NPZ of objects": saved(lambda file, what: np.savez(file, what), objects),
        "an NPY of objects": saved(np.save, objects),
        "weights before a pickle": good + pickled,
        "half of the weights": good[: len(good) // 2],
        "a header that is a pickle": safetensors(pickled),
        "a header beyond the file": struct.pack("<Q", 2**62) + b"{}",
        "offsets beyond the file": safetensors({"a": {**tensor, "data_offsets": [0, 2**40]}}),
        "a shape beyond memory": safetensors({"a": {**tensor, "shape": [2**40, 2**20]}}),
        "another tensor": safetensors({"a": tensor}, b"\0" * 8),
        "nothing": b"",
    }


VARIANTS = sorted(hostile_files("marker", b"weights"))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("application", APPLICATIONS)
def test_no_agents_file_runs_code(application, variant, tmp_path):
    marker, file = tmp_path / "ran", tmp_path / "agent.safetensors"
    (first, *_) = agents.names(application)
    good = agents.card(first, application).path.read_bytes()
    file.write_bytes(hostile_files(marker, good)[variant])
    with pytest.raises(UserError, match="Expected"):
        agents.load(file, application)
    assert not marker.exists()


def trained(name):
    oracle = FunctionOracle(lambda mu: np.abs(mu).mean(axis=1), budget=60)
    adversary = adversaries.make(name, 2, seed=0, **QUICK.get(name, {}))
    adversary.train(oracle)
    return adversary


@pytest.mark.parametrize("name", adversaries.names())
def test_no_adversarys_folder_runs_code(name, tmp_path):
    if name == "cma-mae":
        pytest.importorskip("ribs")
    adversary, folder, marker = trained(name), tmp_path / "adversary", tmp_path / "ran"
    adversary.save(folder)
    pickled = pickle.dumps(Payload(marker))
    objects = saved(lambda file, what: np.savez(file, what), np.array([Payload(marker)], object))
    for file in sorted(folder.iterdir()):
        good = file.read_bytes()
        for content in (pickled, objects, zipped("a.npy", pickled), good[: len(good) // 2], b""):
            file.write_bytes(content)
            with pytest.raises(UserError, match="Expected"):
                type(adversary).load(folder)
        if file.suffix == ".json":
            record = json.loads(good)
            for key in record:
                for value in (None, [], {"a": 1}, "../../..", 1e308):
                    file.write_text(json.dumps({**record, key: value}))
                    try:  # some values are good ones
                        type(adversary).load(folder)
                    except UserError as error:
                        assert "Expected" in str(error)  # noqa: PT017
        file.write_bytes(good)
    assert not marker.exists()
    type(adversary).load(folder).sample(2)
