import ast
from pathlib import Path

import pytest

from sada_gym.adversaries import models

(FOLDER,) = map(Path, models.__path__)


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.py")), ids=lambda file: file.stem)
def test_models_know_no_adversary_no_query_and_no_option(file):
    imported = {
        node.module
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("sada_gym.")
    }
    allowed = ("sada_gym.adversaries.models.", "sada_gym.errors")
    assert all(module.startswith(allowed) for module in imported), imported
