"""Prints the lines of Python of each folder beside the last landed ones: the house has a budget."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import PurePosixPath

BUDGET = 52_000
"""The most lines of the package and the leaderboard; an issue that adds says how many."""

_FILES = ("sada_gym/*.py", "leaderboard/*.py")


def _git(*words: str) -> list[str]:
    return subprocess.run(["git", *words], capture_output=True, text=True).stdout.splitlines()


def _lines(*tree: str) -> Counter[str]:
    """Count the lines by folder: of a commit, or of the working tree."""
    lines: Counter[str] = Counter()
    for counted in _git("grep", "-c", "-e", "", *tree, "--", *_FILES):
        *_, path, count = counted.split(":")
        lines["/".join(PurePosixPath(path).parent.parts[:2])] += int(count)
    return lines


def main() -> None:
    """Print a line a folder, and the total beside the budget."""
    landed = next(iter(_git("merge-base", "HEAD", "main")), "HEAD")
    now, then = _lines("--untracked"), _lines(landed)
    for folder in sorted(now | then):
        print(f"{folder:28}{now[folder]:8,}{now[folder] - then[folder]:+8,}")
    print(f"{'total':28}{now.total():8,}{now.total() - then.total():+8,}   budget {BUDGET:,}")


if __name__ == "__main__":
    main()
