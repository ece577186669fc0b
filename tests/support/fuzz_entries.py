"""Fuzzes the checks of entries: `python tests/support/fuzz_entries.py --seconds 600 --seed 0`.

Good entries are spoilt at random: bytes, values of JSON, headers of arrays, lines of TOML, names of
files. Whatever comes out must pass or be refused with a sentence; anything else is a crash.
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import json
import shutil
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from made_entries import make_entry

from sada_gym.board.results.entry import read_entry
from sada_gym.board.submission.checks import check_entry
from sada_gym.errors import UserError
from sada_gym.experiment.record import place_of, slug

Rng = np.random.Generator
SLOW_S = 5.0
ODD_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63), 10**30, 0.5, -0.0, 1e308, -1e-300),
    *("", " ", "x" * 300, "../..", "\x1b[2J", "\u202e", "<script>", "nan", "ü", "😀", "a\nb", "\0"),
    *([], {}, [[]], [None], {"": None}, {"a": {"b": [1, {"c": None}]}}, ["a"] * 200),
)
ODD_TEXTS = (
    *("NaN", "Infinity", "-Infinity", "1e999", "9" * 400, "9" * 5_000, '"\\ud800"', '"\\u0000"'),
    *('{"a": 1, "a": 2}', "[" * 3_000 + "]" * 3_000, '{"a":' * 500 + "1" + "}" * 500, "", "//"),
)
ODD_TOML = (
    *("x = 1", "format = 2", 'name = "a"', "[a]", "[[a]]", 'a.b.c = "x"', "a = " + "[" * 900, "\0"),
    *("authors = 1", "format = 1e400", "format = " + "9" * 5_000, 'title = """a\nb"""', "\ufeff"),
    *("paper = 2026-11-24", "options = {a = 1}", "title = true", "authors = [[]]", "\x7f", "="),
)
ODD_HEADERS = (
    *("(" * 5_000, "-" * 7_000 + "1", "{" * 150, "[]", "1", "'a' * 10**9", "lambda: 0", "{}", "\0"),
    *("{'descr': '|O', 'fortran_order': False, 'shape': (2, 2)}",),
    *("{'descr': '<f4', 'fortran_order': 1, 'shape': (2, 2)}",),
    *("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,)}",),
    *("{'descr': [('a', [('b', 'O')])], 'fortran_order': False, 'shape': (2,)}",),
    *("{'descr': '<U999999999', 'fortran_order': False, 'shape': (0, 2)}",),
    *("{'descr': '<f4', 'fortran_order': False, 'shape': (True, False)}",),
    *("{'descr': '<f4', 'fortran_order': True, 'shape': (0, 10**30)}",),
    *("{'descr': '<f4', 'fortran_order': True, 'shape': (0, 1" + "0" * 40 + ")}",),
    *("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -4)}",),
    *("{'descr': 'M8[s]', 'fortran_order': False, 'shape': (0, 0)}",),
    *("{'descr': ('<f4', (2, 2)), 'fortran_order': False, 'shape': (1,)}",),
    *("{'descr': '<f4,<f4', 'fortran_order': False, 'shape': ()}",),
    *("{'descr': None, 'fortran_order': False, 'shape': None}",),
)


@dataclass
class Report:
    """What a run of the fuzzer found.

    Attributes:
        passed: Spoilt entries that passed: what was changed says nothing, or was put right.
        refused: Those that were refused with a sentence.
        sentences: How often each beginning of a sentence came.
        crashes: What happened else: the seed of the case, how it was spoilt, and the traceback.
    """

    passed: int = 0
    refused: int = 0
    sentences: Counter[str] = field(default_factory=Counter)
    crashes: list[str] = field(default_factory=list)


def fuzz(folder: Path, *, seconds: float, seed: int, least: int = 0) -> Report:
    """Spoil and check entries for some seconds.

    Args:
        folder: A folder to work in.
        seconds: How long.
        seed: Fixes the cases; each has the seed `(seed, number)`.
        least: The least number of cases, however long they take.
    """
    folder.mkdir(parents=True, exist_ok=True)
    goods = [
        make_entry(folder / "good", "foreign"),
        make_entry(
            folder / "good",
            "ours",
            track="SADA-Digits-3-v0",
            agent="cnn",
            adversary="bbgan-boost",
            preset="paper",
            options={"steps": 10},
        ),
    ]
    for good in goods:
        check_entry(good)
    report, end, number = Report(), time.monotonic() + seconds, 0
    while number < least or time.monotonic() < end:
        _try_one(goods[number % len(goods)], folder / "case", (seed, number), report)
        number += 1
    return report


def _try_one(good: Path, parent: Path, case: tuple[int, int], report: Report) -> None:
    rng = np.random.default_rng(case)
    shutil.rmtree(parent, ignore_errors=True)
    entry = parent / good.name
    shutil.copytree(good, entry)
    done = []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        spoil = SPOILERS[int(rng.integers(len(SPOILERS)))]
        done.append(spoil.__name__)
        spoil(entry, rng)
    start = time.process_time()
    try:
        check_entry(entry, submission=bool(rng.integers(2)))
        read_entry(entry)
        report.passed += 1
    except UserError as error:
        text = str(error)
        report.refused += 1
        report.sentences[" ".join(text.split()[:4])] += 1
        if not (text.isprintable() and text.startswith("Expected ") and len(text) < 4_000):
            report.crashes.append(f"{case} {done}: a bad sentence: {text[:2_000]!r}")
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        report.crashes.append(f"{case} {done}: {traceback.format_exc()[-3_000:]}")
    if time.process_time() - start > SLOW_S:
        report.crashes.append(f"{case} {done}: {time.process_time() - start:.1f} s")


def _pick(rng: Rng, among: Any) -> Any:
    return copy.deepcopy(among[int(rng.integers(len(among)))])


def _files(entry: Path, ending: str = "") -> list[Path]:
    return sorted(path for path in entry.iterdir() if path.name.endswith(ending) and path.is_file())


def change_bytes(entry: Path, rng: Rng) -> None:
    """Change, remove, repeat or insert some bytes of a file."""
    paths = _files(entry)
    if not paths:
        return
    path = _pick(rng, paths)
    content = bytearray(path.read_bytes())
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(len(content) + 1))
        length = int(rng.integers(1, 40))
        match int(rng.integers(5)):
            case 0:
                content[at : at + 1] = rng.bytes(1)
            case 1:
                del content[at : at + length]
            case 2:
                content[at:at] = content[at : at + length]
            case 3:
                content[at:at] = rng.bytes(length)
            case 4:
                del content[at:]
    path.write_bytes(content)


def _places(value: Any) -> list[tuple[Any, Any]]:
    """List all places in what JSON holds, as a container and a key."""
    keys = value.keys() if isinstance(value, dict) else range(len(value))
    places: list[tuple[Any, Any]] = []
    for key in list(keys):
        places.append((value, key))
        if isinstance(value[key], dict | list):
            places += _places(value[key])
    return places


def change_json(entry: Path, rng: Rng) -> None:
    """Put odd values into the claims; half of the time hashes and names follow."""
    paths = _files(entry, ".json")
    if not paths:
        return
    path = _pick(rng, paths)
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return
    if not isinstance(content, dict | list):
        return
    for _ in range(int(rng.integers(1, 4))):
        places = _places(content)
        if not places:
            break
        container, key = places[int(rng.integers(len(places)))]
        match int(rng.integers(4)):
            case 0 | 1:
                container[key] = _pick(rng, ODD_VALUES)
            case 2:
                del container[key]
            case 3:
                if isinstance(container, dict):
                    container[_pick(rng, ("", "x", "\x1b[2J", "a.b", "seed"))] = container[key]
                else:
                    container.insert(0, _pick(rng, ODD_VALUES))
    if rng.integers(2):
        fix_claims(path, content)
    else:
        path.write_text(json.dumps(content))


def fix_claims(path: Path, content: Any, *, rename: bool = True) -> None:
    """Write claims with the hashes, the order and the files' names that fit, as far as they go."""
    results = content.get("results") if isinstance(content, dict) else None
    results = results if isinstance(results, list) else []
    places, group = {}, ""
    for result in results:
        try:
            experiment = result["experiment"]
            canonical = json.dumps(experiment, sort_keys=True, separators=(",", ":"))
            result["sha256"] = hashlib.sha256(canonical.encode()).hexdigest()
            target = experiment["target"]
            texts = target["track"], target["agent"], experiment["protocol"]["rule"]
            places[id(result)] = place_of(*texts)
            group = slug(target["application"]["name"])
        except (KeyError, TypeError, AttributeError, ValueError, IndexError):
            continue
    if len(places) == len(results) > 1:
        results.sort(key=lambda result: places[id(result)])
    samples = path.with_suffix(".npz")
    if rename and 0 < len(group) < 150 and samples.exists():
        path.unlink(missing_ok=True)
        path = path.with_name(f"{group}.json")
        samples.rename(path.with_suffix(".npz"))
    path.write_text(json.dumps(content))


def change_json_text(entry: Path, rng: Rng) -> None:
    """Put odd text in the place of a value of JSON."""
    paths = _files(entry, ".json")
    if not paths:
        return
    path = _pick(rng, paths)
    parts = path.read_bytes().split(b": ")
    if len(parts) < 2:
        return
    at = int(rng.integers(1, len(parts)))
    rest = parts[at].split(b",", 1)[1:]
    parts[at] = b",".join([_pick(rng, ODD_TEXTS).encode(), *rest])
    path.write_bytes(b": ".join(parts))


def change_toml(entry: Path, rng: Rng) -> None:
    """Remove, repeat, insert or spoil a line of entry.toml."""
    path = entry / "entry.toml"
    if not path.is_file():
        return
    lines = path.read_bytes().split(b"\n")
    at = int(rng.integers(len(lines)))
    match int(rng.integers(4)):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[at])
        case 2:
            lines.insert(at, _pick(rng, ODD_TOML).encode())
        case 3:
            key = lines[at].split(b"=")[0]
            lines[at] = key + b"= " + json.dumps(_pick(rng, ODD_VALUES)).encode()
    path.write_bytes(b"\n".join(lines))


def change_arrays(entry: Path, rng: Rng) -> None:
    """Write arrays with odd headers, other bytes or other names, and write the archive anew."""
    paths = _files(entry, ".npz")
    if not paths:
        return
    path = _pick(rng, paths)
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = [(name, archive.read(name)) for name in archive.namelist()]
    except Exception:
        return  # spoilt already
    if not arrays:
        return
    at = int(rng.integers(len(arrays)))
    name, content = arrays[at]
    match int(rng.integers(6)):
        case 0:
            line = _pick(rng, ODD_HEADERS).encode() + b"\n"
            version = bytes([int(rng.integers(0, 4)), 0]) if rng.integers(4) == 0 else b"\x01\x00"
            arrays[at] = (
                name,
                b"\x93NUMPY" + version + struct.pack("<H", len(line)) + line + content,
            )
        case 1:
            arrays[at] = name, content[: int(rng.integers(len(content) + 1))]
        case 2:
            changed = bytearray(content)
            for place in rng.integers(len(content), size=3) if content else ():
                changed[place] = int(rng.integers(256))
            arrays[at] = name, bytes(changed)
        case 3:
            arrays[at] = _pick(rng, ("x.npy", "../x.npy", "mu", "", "mu.npy", "a\0.npy")), content
        case 4:
            del arrays[at]
        case 5:
            arrays.append(_pick(rng, arrays))
    kind = zipfile.ZIP_STORED if rng.integers(4) else zipfile.ZIP_DEFLATED
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", kind) as archive:
        warnings.simplefilter("ignore")  # of names that stand twice
        for name, content in arrays:
            archive.writestr(name or "-", content)


def change_numbers(entry: Path, rng: Rng) -> None:
    """Put odd numbers into the samples, whose file stays a good one."""
    paths = _files(entry, ".npz")
    if not paths:
        return
    path = _pick(rng, paths)
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception:
        return  # spoilt already
    if not arrays:
        return
    array = arrays[_pick(rng, sorted(arrays))]
    if array.size and array.dtype.kind in "if":
        odd = (np.nan, np.inf, -np.inf, -0.0, 1e38) if array.dtype.kind == "f" else (-1, 2**62, 3)
        array.reshape(-1)[int(rng.integers(array.size))] = _pick(rng, odd)
    np.savez(path, **arrays)


def change_files(entry: Path, rng: Rng) -> None:
    """Remove, add, empty, swap or rename files."""
    paths = _files(entry)
    if not paths:
        return
    path = _pick(rng, paths)
    match int(rng.integers(6)):
        case 0:
            path.unlink()
        case 1:
            content = path.read_bytes()
            (entry / _pick(rng, ("x.json", "x.npz", ".x", "x.verified.json"))).write_bytes(content)
        case 2:
            path.write_bytes(b"")
        case 3:
            content = path.read_bytes()
            _pick(rng, paths).with_suffix(".verified.json").write_bytes(content)
        case 4:
            path.rename(entry / _pick(rng, ("y.json", "y.npz", "\x1b[2J", "entry.toml", "é.json")))
        case 5:
            content = path.read_bytes()
            other = _pick(rng, paths)
            path.write_bytes(other.read_bytes())
            other.write_bytes(content)


SPOILERS: tuple[Callable[[Path, Rng], None], ...] = (
    *(change_bytes, change_json, change_json, change_json_text, change_toml),
    *(change_arrays, change_numbers, change_files),
)


def main() -> int:
    """Run the fuzzer and say what it found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="where crashes are written down")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        report = fuzz(Path(name), seconds=options.seconds, seed=options.seed)
    for sentence, times in report.sentences.most_common(40):
        print(f"{times:7,} {sentence}")
    print(
        f"{report.passed + report.refused + len(report.crashes):,} entries: "
        f"{report.refused:,} refused with a sentence of {len(report.sentences)} kinds, "
        f"{report.passed:,} passed, {len(report.crashes)} crashes"
    )
    text = "\n".join(report.crashes)
    if options.out:
        options.out.write_text(text)
    elif text:
        print(text)
    return 1 if report.crashes else 0


if __name__ == "__main__":
    sys.exit(main())
