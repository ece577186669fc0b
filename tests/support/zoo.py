"""Packages of others that the extra `zoo` installs: tests without them are skipped."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from sada_gym.agents.packaged import missing_packages

VERSIONS = {
    "foundation-policy": "1.0.2",
    "h5py": "",
    "jsbsim": "1.3.3",
    "metadrive-simulator": "0.4.3",
    "mujoco": "",
    "onnxruntime": "",
}


def needs(*packages: str) -> pytest.MarkDecorator:
    """Skip a test where one of these packages is missing."""
    wanted: Mapping[str, str] = {name: VERSIONS[name] for name in packages}
    sentence = missing_packages(wanted)
    return pytest.mark.skipif(bool(sentence), reason=sentence)
