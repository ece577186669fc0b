"""Hostile and broken submissions get one sentence each, run no code and change nothing."""

import hashlib
import io
import json
import os
import pickle
import shutil
import struct
import time
import zipfile

import numpy as np
import pytest
from fuzz_entries import fuzz
from made_entries import ANALYTIC, make_entry
from sada_gym.submission.models import result_stem

from sada_gym.errors import UserError
from sada_gym.submission.checks import MAX_FILES, check_entry

STEM = f"{ANALYTIC}.paper-budgets"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return make_entry(tmp_path_factory.mktemp("entries"))


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return open, (self.marker, "w")


# each changes a good entry, and gives the folder to check where that is another one


def link(folder):
    (folder.parent / "secret").write_bytes((folder / f"{STEM}.npz").read_bytes())
    (folder / f"{STEM}.npz").unlink()
    (folder / f"{STEM}.npz").symlink_to(folder.parent / "secret")


def dangling_link(folder):
    (folder / "entry.toml").unlink()
    (folder / "entry.toml").symlink_to("/nowhere")


def linked_folder(folder):
    (folder.parent / "other").symlink_to(folder)
    return folder.parent / "other"


def pipe(folder):
    (folder / f"{STEM}.json").unlink()
    os.mkfifo(folder / f"{STEM}.json")


def sub_folder(folder):
    (folder / "more").mkdir()


def folder_for_file(folder):
    (folder / f"{STEM}.json").unlink()
    (folder / f"{STEM}.json").mkdir()


def extra(name, content=b"x"):
    def spoil(folder):
        (folder / name).write_bytes(content)

    return spoil


def many_files(folder):
    for i in range(MAX_FILES):
        (folder / f"{i}.json").touch()


def many_bytes(folder):
    for i in range(9):
        with (folder / f"{i}.npz").open("wb") as file:
            file.truncate(2**24)  # sparse


def huge(name, size):
    def spoil(folder):
        with (folder / name).open("wb") as file:
            file.truncate(size)  # sparse

    return spoil


def without(*names):
    def spoil(folder):
        for name in names:
            (folder / name).unlink()

    return spoil


def renamed(name):
    def spoil(folder):
        return folder.rename(folder.parent / name)

    return spoil


def about(old, new):
    def spoil(folder):
        path = folder / "entry.toml"
        text = path.read_text()
        assert old in text
        path.write_bytes(text.replace(old, new, 1).encode("utf-8", "surrogatepass"))

    return spoil


def claims_text(old, new):
    def spoil(folder):
        path = folder / f"{STEM}.json"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return spoil


def claims(change):
    """Change what the JSON holds, with an identity whose hash and names fit."""

    def spoil(folder):
        path = folder / f"{STEM}.json"
        found = json.loads(path.read_text())
        change(found)
        told = found["identity"]
        canonical = json.dumps(told, sort_keys=True, separators=(",", ":"))
        found["identity_sha256"] = hashlib.sha256(canonical.encode()).hexdigest()
        path.unlink()
        stem = result_stem(told["track"], told["agent"], told["rule"])
        (folder / f"{stem}.json").write_text(json.dumps(found))
        (folder / f"{STEM}.npz").rename(folder / f"{stem}.npz")

    return spoil


def identity(**changes):
    return claims(lambda found: found["identity"].update(changes))


def seed(**changes):
    return claims(lambda found: found["seeds"][1].update(changes))


def measures(**changes):
    return claims(lambda found: found["seeds"][1]["measures"].update(changes))


def arrays(change, save=np.savez):
    def spoil(folder):
        path = folder / f"{STEM}.npz"
        with np.load(path) as file:
            held = dict(file)
        change(held)
        buffer = io.BytesIO()
        save(buffer, **held)
        path.write_bytes(buffer.getvalue())

    return spoil


def put(name, index, value):
    return arrays(lambda held: held[name].__setitem__(index, value))


def retyped(name, dtype):
    return arrays(lambda held: held.update({name: held[name].astype(dtype)}))


def pickled(folder):
    objects = np.array([Payload(folder.parent / "ran")], dtype=object)
    return arrays(lambda held: held.update({"mu": objects}))(folder)


def pickle_for_archive(folder):
    (folder / f"{STEM}.npz").write_bytes(pickle.dumps(Payload(folder.parent / "ran")))


def member_twice(folder):
    with (
        zipfile.ZipFile(folder / f"{STEM}.npz", "a") as archive,
        pytest.warns(UserWarning, match="Duplicate"),
    ):
        archive.writestr("mu.npy", b"")


def member_outside(folder):
    with zipfile.ZipFile(folder / f"{STEM}.npz", "a") as archive:
        archive.writestr("../../x.npy", b"")


def bomb(folder):
    """A file of a few kilobytes that decompresses to megabytes."""
    path = folder / f"{STEM}.npz"
    with zipfile.ZipFile(path) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in held.items():
            archive.writestr(name, bytes(2**22) if name == "mu.npy" else content)


def header(text):
    """An array whose header says anything."""

    def spoil(folder):
        path = folder / f"{STEM}.npz"
        with zipfile.ZipFile(path) as archive:
            held = {name: archive.read(name) for name in archive.namelist()}
        line = text.encode() + b"\n"
        held["mu.npy"] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(line)) + line
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in held.items():
                archive.writestr(name, content)

    return spoil


def deep(folder):
    path = folder / f"{STEM}.json"
    path.write_text('{"a":' * 100_000 + "1" + "}" * 100_000)


HOSTILE = {
    # files
    "a link to a file outside": (link, "Expected a regular file in .*npz, got a link"),
    "a link to nowhere": (dangling_link, "Expected a regular file in .*toml, got a link"),
    "a link for the folder": (linked_folder, "Expected the folder of an entry, got .*other, whi"),
    "a pipe": (pipe, "Expected a regular file in .*json, got a link, a folder or a device"),
    "a sub-folder": (sub_folder, r"Expected only entry.toml and results in .*, got 'more'"),
    "a folder called as a file": (folder_for_file, "Expected a regular file in .*json, got"),
    "code": (extra("setup.py"), "Expected only .*, got 'setup.py'"),
    "a hidden file": (extra(".gitattributes"), "Expected only .*, got '.gitattributes'"),
    "an archive": (extra("more.zip"), "Expected only .*, got 'more.zip'"),
    "a name that a terminal obeys": (extra("\x1b[2Ja\n.json"), r"got '.x1b\[2Ja.n.json'"),
    "a name that is no UTF-8": (extra(os.fsdecode(b"\xff.json")), r"got '.udcff.json'"),
    "markup in a file's name": (extra("<b>.json"), "got '<b>.json'"),
    "too many files": (many_files, "Expected at most 1,000 files in .*, got more"),
    "too many bytes in all": (many_bytes, "Expected at most 128 MiB in .*, got 144 MiB"),
    "a huge JSON": (huge(f"{STEM}.json", 2**40), "Expected at most 4,194,304 bytes in .*json"),
    "a huge NPZ": (huge(f"{STEM}.npz", 2**40), "Expected at most 16,777,216 bytes in .*npz"),
    "a huge TOML": (huge("entry.toml", 2**40), "Expected at most 65,536 bytes in .*toml"),
    "an NPZ beyond its claims": (huge(f"{STEM}.npz", 2**20), "bytes for 2 x 250 samples in"),
    "no entry.toml": (without("entry.toml"), r"Expected entry.toml in .*, got none"),
    "no samples": (without(f"{STEM}.npz"), r"Expected .*.npz beside .*.json in"),
    "no claims": (without(f"{STEM}.json"), r"Expected .*.json beside .*.npz in"),
    "no results": (without(f"{STEM}.json", f"{STEM}.npz"), "Expected at least one result in"),
    "nothing": (without("entry.toml", f"{STEM}.json", f"{STEM}.npz"), r"Expected entry.toml in"),
    "a verified file": (extra(f"{STEM}.verified.json", b"{}"), "Expected no results of the verif"),
    # names
    "a folder of another name": (renamed("yours"), "Expected the folder of the entry mine to have"),
    "a name of Windows": (renamed("aux"), "Expected an entry's folder to be named by"),
    "markup in the folder's name": (renamed("<script>"), "got '<script>'. Rename it"),
    "the way out in a name": (about('name = "mine"', 'name = "../mine"'), "expected a name of at"),
    "markup in the name": (about('name = "mine"', 'name = "<b>mine</b>"'), "expected a name of at"),
    "a title that a terminal obeys": (
        about("My method", "\\u001b[2J"),
        "expected text in one line",
    ),
    "text that runs backwards": (about("My method", "\u202ehtap"), "expected text in one line"),
    "a title beyond measure": (about("My method", "x" * 60_000), "title: .* at most 200"),
    "no title": (about("My method", " "), "Expected a text as title"),
    # entry.toml
    "a surrogate": (about("My method", "\ud800"), "Expected a TOML file in"),
    "a field too many": (about("format = 1", "format = 1\nrank = 1"), "rank: Extra inputs"),
    "a key twice": (about("format = 1", "format = 1\nformat = 1"), "Expected a TOML file in"),
    "another format": (about("format = 1", "format = 2"), "Expected format 1 in .*, got 2"),
    "no authors": (about('["Ada L.", "Grace H."]', "[]"), "Expected a text as authors"),
    "no licence": (about("CC-BY-4.0", ""), "Expected a text as licence"),
    "markup for a licence": (about("CC-BY-4.0", "<i>"), "Expected a licence's SPDX name"),
    "a script for an address": (
        about("https://example.org/paper", "javascript:alert(1)"),
        "Expected the address of a page as paper",
    ),
    "markup in an address": (
        about("https://example.org/code", "https://x.org/'onclick=1"),
        "Expected the address of a page as repository",
    ),
    "options that are no object": (
        about('{\\"width\\": 0.5}', "[]"),
        "options that are a JSON obj",
    ),
    "options that are no JSON": (about('{\\"width\\": 0.5}', "{"), "Expected plain JSON in .*toml"),
    "options of another run": (about("0.5", "0.6"), "Expected the options of entry.toml"),
    "another adversary": (about('"my-method"', '"gp"'), "Expected the adversary of entry.toml"),
    # the claims
    "JSON without end": (deep, "Expected plain JSON in .*, got one nested too deeply"),
    "a NaN": (claims_text('"mean_score": 0', '"mean_score": NaN, "x": 0'), "NaN, which is no fin"),
    "an infinity": (claims_text('"width": 0.5', '"width": 1e999'), "1e999, which is no finite nu"),
    "a number of 5,000 digits": (claims_text('"width": 0.5', f'"width": {"9" * 5_000}'), "64 bits"),
    "a key of JSON twice": (
        claims_text('"format": 1', '"format": 1, "format": 1'),
        "'format' twice",
    ),
    "a number as text": (
        claims_text('"format": 1', '"format": "1"'),
        "format: Input should be a va",
    ),
    "a lone surrogate": (
        claims_text('"width"', '"\\ud800"'),
        "as sada-gym writes it, got a differ",
    ),
    "bytes that are no UTF-8": (
        extra(f"{STEM}.json", b"\xff\xfe{}"),
        "Expected UTF-8 in .*, got something else at byte 0",
    ),
    "an edited identity": (claims_text('"budget": 1000', '"budget": 999'), "instead of editing it"),
    "a field of measures too many": (measures(rank=1), "rank: Extra inputs"),
    "an unknown track": (identity(track="SADA-Moon-v0"), "Expected the track to be one of"),
    "a track that escapes": (
        identity(track="../../etc"),
        "Expected only .*, got '..-..-etc.paper-budgets.npz'",
    ),
    "a track to be imported": (
        identity(track="antigravity:Moon-v0"),
        "Expected the track to be one",
    ),
    "a general id": (identity(track="SADA-Digits-v0"), "Expected the track to be one of"),
    "an agent that is not shipped": (identity(agent="mine"), "Expected no agent's name on"),
    "an agent in a file": (
        identity(track="SADA-Digits-3-v0", agent="../weights.safetensors"),
        "Expected the agent on SADA-Digits-3-v0 to be one of cnn",
    ),
    "an unknown rule": (identity(rule="no-limit"), "Expected the rule to be one of"),
    "a budget of one's own": (identity(budget=10**6), "budget was 1000000 and is 1000"),
    "fewer samples": (identity(samples=10), "samples was 10 and is 250"),
    "an easier threshold": (
        identity(fooling_threshold=0.9),
        "fooling_threshold was 0.9 and is 0.3",
    ),
    "an older version": (identity(version=-1), "version was -1 and is 0"),
    "another agent's weights": (identity(fingerprint="f"), "fingerprint was 'f' and is ''"),
    "other settings": (
        identity(application_settings={"noise": 1}),
        "application_settings.dimension",
    ),
    "a reference set of one's own": (
        identity(reference={"sha256": "", "points": 9, "fooling": 9, "uniform_rate": 0.5}),
        "reference was",
    ),
    "another preset": (identity(preset="paper"), "Expected the preset of entry.toml, None in"),
    "options that were not used": (identity(resolved={}), "Expected resolved options that hold"),
    "no seeds": (claims(lambda found: found.update(seeds=[])), "Expected at least one seed in"),
    "more queries than allowed": (seed(queries=1_001), "Expected at most 1,000 queries of seed 1"),
    "negative queries": (seed(queries=-1), "seeds.1.queries: Input should be greater"),
    "the best seeds": (seed(seed=7), "Expected the seeds 0, 1, 2 and so on in .*, got .0, 7."),
    "seeds out of order": (
        claims(lambda found: found["seeds"].reverse()),
        "Expected ascending seeds in .*, each once",
    ),
    "an error beside measures": (
        seed(error="none"),
        "Expected either measures or an error of seed",
    ),
    "neither error nor measures": (
        seed(measures=None),
        "measures or an error of seed 1 in .*, got n",
    ),
    "a search of other queries": (
        seed(search={"queries": 5, "fooled": 1, "curve": []}),
        "Expected a search of 900 queries of seed 1",
    ),
    "a newer sada_gym": (
        seed(packages={"sada_gym": "99.0"}),
        "Expected sada_gym .* or older of seed",
    ),
    "no sada_gym": (seed(packages={}), "Expected the version of sada_gym among the packages"),
    "markup for a version": (
        seed(packages={"<b>": "1"}),
        "Expected names and versions of packages",
    ),
    "a better AFR": (measures(afr=1.0), "Expected afr = .* of seed 1, as its samples give it"),
    "more fooled": (measures(fooled=250), "Expected fooled = .* of seed 1, as its samples give it"),
    "a narrower interval": (measures(afr_interval_95=[0.5, 0.5]), r"Expected afr_interval_95.0 ="),
    "a lower score": (measures(mean_score=0.0), "Expected mean_score = .* of seed 1"),
    "a wider spread": (measures(mu_std=1.0), "Expected mu_std = .* of seed 1, as its samples"),
    "coverage without a reference set": (measures(coverage=1.0), "Expected no coverage of seed 1"),
    "negative novelty": (
        measures(novelty={"median": -1.0, "fifth_percentile": 0.0, "minimum": 0.0, "repeats": 0}),
        "Expected no negative numbers of seed 1",
    ),
    "feasible worlds that are not there": (
        measures(feasible={"worlds": 9_999, "fooled": 1, "afr": 0.1}),
        "Expected at most 250 feasible worlds of seed 1",
    ),
    # the samples
    "a pickle": (pickle_for_archive, "Expected an NPZ file with the arrays"),
    "an array of objects": (pickled, "mu of dtype object"),
    "a bomb": (bomb, "run is compressed"),
    "compressed arrays": (arrays(dict.copy, np.savez_compressed), "is compressed"),
    "an array twice": (member_twice, "arrays named mu, mu, run, score, seed"),
    "an array outside": (member_outside, "arrays named ../../x, mu"),
    "an array too many": (arrays(lambda held: held.update(x=np.zeros(1))), "arrays named mu, run"),
    "an array too few": (arrays(lambda held: held.pop("seed")), "arrays named mu, run, score"),
    "a shape beyond memory": (
        header("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 2)}"),
        r"mu of shape \(1000000000000, 2\) in 0 bytes",
    ),
    "a negative shape": (
        header("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -1)}"),
        r"mu of shape \(-1, -1\) in 0 bytes",
    ),
    "a header without end": (header("(" * 7_000), "it is damaged"),
    "a header of signs": (header("-" * 7_000 + "1"), "it is damaged"),
    "a header that is code": (header("__import__('os').system('x')"), "it is damaged"),
    "half an archive": (
        lambda folder: os.truncate(folder / f"{STEM}.npz", 4_000),
        "it is damaged",
    ),
    "mu of double precision": (retyped("mu", np.float64), "mu of dtype float64|bytes for 2 x 250"),
    "scores of single precision": (retyped("score", np.float32), "score of dtype float32"),
    "big-endian mu": (retyped("mu", ">f4"), "mu of dtype >f4"),
    "unsigned seeds": (retyped("seed", np.uint64), "seed of dtype uint64"),
    "one column": (
        arrays(lambda held: held.update(mu=held["mu"][:, :1])),
        r"mu of shape \(250, 2\)",
    ),
    "flat mu": (arrays(lambda held: held.update(mu=held["mu"][:, 0])), r"mu of dtype .* \(500,\)"),
    "rows that do not match": (
        arrays(lambda held: held.update(score=held["score"][1:])),
        "Expected as many rows of mu as scores and seeds",
    ),
    "a sample too few": (
        arrays(lambda held: held.update({name: held[name][1:] for name in held})),
        "Expected 250 samples of seed 0 in .*, got 249",
    ),
    "samples of no seed": (put("run", 0, 9), r"Expected samples of the seeds .0, 1., as claimed"),
    "a NaN for mu": (put("mu", (3, 1), np.nan), r"Expected mu of seed 0 within \[-1, 1\] in"),
    "mu outside the box": (put("mu", (3, 1), 1.01), r"Expected mu of seed 0 within \[-1, 1\] in"),
    "an infinite score": (put("score", 3, -np.inf), r"Expected scores of seed 0 within \[0, 1\]"),
    "a score above 1": (put("score", 3, 1.5), r"Expected scores of seed 0 within \[0, 1\]"),
    "seeds of one's own": (put("seed", 3, 4), "Expected the evaluation seeds of the test stream"),
    "better scores": (put("score", slice(0, 250), 0.0), "Expected fooled = 250 of seed 0"),
}


def snapshot(folder):
    """Everything below a folder, without following links."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        found[str(path)] = (status.st_mode, status.st_size, status.st_mtime_ns)
    return found


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_entry_gets_a_sentence(good, tmp_path, kind):
    spoil, said = HOSTILE[kind]
    folder = tmp_path / good.name
    shutil.copytree(good, folder)
    folder = spoil(folder) or folder
    before, start = snapshot(tmp_path), time.process_time()
    with pytest.raises(UserError, match=said) as caught:
        check_entry(folder)
    sentence = str(caught.value)
    assert time.process_time() - start < 5
    assert sentence.startswith("Expected ")
    assert sentence.isprintable()
    assert len(sentence) < 1_500
    assert snapshot(tmp_path) == before
    assert not (tmp_path / "ran").exists()


def test_there_are_many_kinds():
    assert len(HOSTILE) >= 40


@pytest.mark.parametrize("text", ["<b>bold</b>", "Ada <ada@example.org>", "A & B", "ÅÄ 自动"])
def test_markup_in_texts_for_people_is_plain_text(good, tmp_path, text):
    # the board escapes it; "Ada <ada@example.org>" is how many write an author
    folder = tmp_path / good.name
    shutil.copytree(good, folder)
    about("My method", text)(folder)
    about("Ada L.", text)(folder)
    check_entry(folder)


def test_a_few_seconds_of_fuzzing_find_no_crash(tmp_path):
    report = fuzz(tmp_path, seconds=2, seed=1, least=60)
    assert report.crashes == []
    assert report.refused > 30
