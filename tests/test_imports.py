"""Modules import one another in one direction only; lint-imports keeps the order of the rooms."""

from graphlib import TopologicalSorter

import pytest

grimp = pytest.importorskip("grimp", reason="import-linter brings it")


def test_no_modules_import_one_another():
    """Imports within functions and those for type checking count too."""
    graph = grimp.build_graph(
        "sada_gym", "leaderboard", exclude_type_checking_imports=False, cache_dir=None
    )
    imported = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    TopologicalSorter(imported).prepare()  # raises a CycleError, which names the circle
