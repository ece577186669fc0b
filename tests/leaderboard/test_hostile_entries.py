"""Hostile and broken submissions get one sentence each, run no code and change nothing."""

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
from fuzz_entries import fix_claims, fuzz
from made_entries import ANALYTIC, make_entry, only_result

from sada_gym.board.results.entry import GroupFiles
from sada_gym.board.submission.checks import check_entry
from sada_gym.board.submission.files import MAX_FILES
from sada_gym.errors import UserError

GROUP = "SADA-Analytic"
PLACE = f"{ANALYTIC}.paper-budgets"
OF_SEED_0 = f"for seed 0 of {PLACE} in .*npz"
OF_SEED_1 = f"for seed 1 of {PLACE} in .*json"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return make_entry(tmp_path_factory.mktemp("entries"))


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return open, (self.marker, "w")


# each changes a good entry, and returns the folder to check where that is another one


def link(folder):
    (folder.parent / "secret").write_bytes((folder / f"{GROUP}.npz").read_bytes())
    (folder / f"{GROUP}.npz").unlink()
    (folder / f"{GROUP}.npz").symlink_to(folder.parent / "secret")


def dangling_link(folder):
    (folder / "entry.toml").unlink()
    (folder / "entry.toml").symlink_to("/nowhere")


def linked_folder(folder):
    (folder.parent / "other").symlink_to(folder)
    return folder.parent / "other"


def pipe(folder):
    (folder / f"{GROUP}.json").unlink()
    os.mkfifo(folder / f"{GROUP}.json")


def sub_folder(folder):
    (folder / "more").mkdir()


def folder_for_file(folder):
    (folder / f"{GROUP}.json").unlink()
    (folder / f"{GROUP}.json").mkdir()


def extra(name, content=b"x"):
    def spoil(folder):
        (folder / name).write_bytes(content)

    return spoil


def many_files(folder):
    for i in range(MAX_FILES):
        (folder / f"{i}.json").touch()


def many_bytes(folder):
    for i in range(9):
        with (folder / f"{i}.json").open("wb") as file:
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


def metadata(old, new):
    def spoil(folder):
        path = folder / "entry.toml"
        text = path.read_text()
        assert old in text
        path.write_bytes(text.replace(old, new, 1).encode("utf-8", "surrogatepass"))

    return spoil


def claims_text(old, new):
    def spoil(folder):
        path = folder / f"{GROUP}.json"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return spoil


def claims(change):
    """Change what the JSON holds; hashes, the order of results and names of files follow."""

    def spoil(folder):
        path = folder / f"{GROUP}.json"
        content = json.loads(path.read_text())
        change(content)
        fix_claims(path, content)

    return spoil


def result(change):
    return claims(lambda content: change(content["results"][0]))


def experiment(part, **changes):
    """Change a part of the experiment, such as `target.application`."""

    def update(result):
        content = result["experiment"]
        for name in filter(None, part.split(".")):
            content = content[name]
        content.update(changes)

    return result(update)


def seed(**changes):
    return result(lambda result: result["seeds"][1].update(changes))


def measures(**changes):
    return result(lambda result: result["seeds"][1]["measures"].update(changes))


def result_twice(folder):
    path = folder / f"{GROUP}.json"
    content = json.loads(path.read_text())
    content["results"] *= 2
    path.write_text(json.dumps(content))


def joined(**changes):
    """Join the results of another entry."""

    def spoil(folder):
        other = make_entry(folder.parent, "other", **changes)
        ((files, theirs),) = [
            (GroupFiles(folder, r.experiment.group), r) for r in [only_result(other)]
        ]
        files.write([*files.read().values(), theirs])

    return spoil


def second_application(folder):
    """Name the application of the results, but not the file, otherwise."""
    path = folder / f"{GROUP}.json"
    text = path.read_text().replace('"name": "SADA-Analytic"', '"name": "SADA-Digits"')
    fix_claims(path, json.loads(text), rename=False)


def place_twice(folder):
    """Claim the same place in the files of two applications."""
    content = json.loads((folder / f"{GROUP}.json").read_text())
    content["results"][0]["experiment"]["target"]["application"]["name"] = "SADA-Other"
    (folder / "SADA-Other.npz").write_bytes((folder / f"{GROUP}.npz").read_bytes())
    fix_claims(folder / "SADA-Other.json", content)


def arrays(change, save=np.savez):
    """Change the arrays of the only result, or their names."""

    def spoil(folder):
        path = folder / f"{GROUP}.npz"
        with np.load(path) as file:
            content = {name.removeprefix(f"{PLACE}."): file[name] for name in file.files}
        change(content)
        names = {name: f"{PLACE}.{name}" if "." not in name else name for name in content}
        buffer = io.BytesIO()
        save(buffer, **{names[name]: array for name, array in content.items()})
        path.write_bytes(buffer.getvalue())

    return spoil


def put(name, index, value):
    return arrays(lambda content: content[name].__setitem__(index, value))


def retyped(name, dtype):
    return arrays(lambda content: content.update({name: content[name].astype(dtype)}))


def placed(name, *, keep):
    """Put the samples into another place, or a few of them beside the others."""

    def change(content):
        rows = {"seeds": 1, "mu": 1, "score": 1} if keep else dict.fromkeys(content)
        copies = {f"{name}.{kind}": content[kind][:count] for kind, count in rows.items()}
        if not keep:
            content.clear()
        content.update(copies)

    return arrays(change)


def pickled(folder):
    objects = np.array([Payload(folder.parent / "ran")], dtype=object)
    return arrays(lambda content: content.update({"mu": objects}))(folder)


def pickle_for_archive(folder):
    (folder / f"{GROUP}.npz").write_bytes(pickle.dumps(Payload(folder.parent / "ran")))


def member_twice(folder):
    with (
        zipfile.ZipFile(folder / f"{GROUP}.npz", "a") as archive,
        pytest.warns(UserWarning, match="Duplicate"),
    ):
        archive.writestr(f"{PLACE}.mu.npy", b"")


def member_outside(folder):
    with zipfile.ZipFile(folder / f"{GROUP}.npz", "a") as archive:
        archive.writestr("../../x.npy", b"")


def bomb(folder):
    """A file of a few kilobytes that decompresses to megabytes."""
    path = folder / f"{GROUP}.npz"
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, bytes(2**22) if name == f"{PLACE}.mu.npy" else content)


def header(text):
    """An array whose header says anything."""

    def spoil(folder):
        path = folder / f"{GROUP}.npz"
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        line = text.encode() + b"\n"
        members[f"{PLACE}.mu.npy"] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(line)) + line
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in members.items():
                archive.writestr(name, content)

    return spoil


def deep(folder):
    path = folder / f"{GROUP}.json"
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
    "too many files": (many_files, "Expected at most 100 files in .*, got more"),
    "too many bytes in all": (many_bytes, "Expected at most 128 MiB in .*, got 144 MiB"),
    "a huge JSON": (huge(f"{GROUP}.json", 2**40), "Expected at most 16,777,216 bytes in .*json"),
    "a huge NPZ": (huge(f"{GROUP}.npz", 2**40), "Expected at most 67,108,864 bytes in .*npz"),
    "a huge TOML": (huge("entry.toml", 2**40), "Expected at most 65,536 bytes in .*toml"),
    "an NPZ beyond its claims": (
        huge(f"{GROUP}.npz", 2**20),
        r"bytes for the samples of 2 seeds in",
    ),
    "no entry.toml": (without("entry.toml"), r"Expected entry.toml in .*, got none"),
    "no samples": (without(f"{GROUP}.npz"), r"Expected .*.npz beside .*.json in"),
    "no claims": (without(f"{GROUP}.json"), r"Expected .*.json beside .*.npz in"),
    "no results": (without(f"{GROUP}.json", f"{GROUP}.npz"), "Expected at least one result in"),
    "nothing": (without("entry.toml", f"{GROUP}.json", f"{GROUP}.npz"), r"Expected entry.toml in"),
    "a verified file": (extra(f"{GROUP}.verified.json", b"{}"), "Expected no results of the verif"),
    # names
    "a folder of another name": (renamed("yours"), "Expected the folder of the entry mine to have"),
    "a name of Windows": (renamed("aux"), "Expected an entry's folder to be named by"),
    "markup in the folder's name": (renamed("<script>"), "got '<script>'. Rename it"),
    "the way out in a name": (
        metadata('name = "mine"', 'name = "../mine"'),
        "expected a name of at",
    ),
    "markup in the name": (
        metadata('name = "mine"', 'name = "<b>mine</b>"'),
        "expected a name of at",
    ),
    "a title that a terminal obeys": (
        metadata("My method", "\\u001b[2J"),
        "expected text in one line",
    ),
    "text that runs backwards": (metadata("My method", "\u202ehtap"), "expected text in one line"),
    "a title beyond measure": (metadata("My method", "x" * 60_000), "title: .* at most 200"),
    "no title": (metadata("My method", " "), "Expected a text as title"),
    # entry.toml
    "a surrogate": (metadata("My method", "\ud800"), "Expected a TOML file in"),
    "a field too many": (metadata("format = 2", "format = 2\nrank = 1"), "rank: Extra inputs"),
    "a key twice": (metadata("format = 2", "format = 2\nformat = 2"), "Expected a TOML file in"),
    "another format": (metadata("format = 2", "format = 1"), "Expected format 2 in .*, got 1"),
    "no authors": (metadata('["Ada L.", "Grace H."]', "[]"), "Expected a text as authors"),
    "no licence": (metadata("CC-BY-4.0", ""), "Expected a text as licence"),
    "markup for a licence": (metadata("CC-BY-4.0", "<i>"), "Expected a licence's SPDX name"),
    "a script for an address": (
        metadata("https://example.org/paper", "javascript:alert(1)"),
        "Expected the address of a page as paper",
    ),
    "markup in an address": (
        metadata("https://example.org/code", "https://x.org/'onclick=1"),
        "Expected the address of a page as repository",
    ),
    "an adversary in entry.toml": (
        metadata("format = 2", 'format = 2\nadversary = "gp"'),
        "adversary: Extra inputs are not permitted",
    ),
    # the claims
    "JSON without end": (deep, "Expected plain JSON in .*, got one nested too deeply"),
    "a NaN": (
        claims_text('"mean_score": 0', '"mean_score": NaN, "x": 0'),
        "NaN, which is not a fin",
    ),
    "an infinity": (
        claims_text('"width": 0.5', '"width": 1e999'),
        "1e999, which is not a finite nu",
    ),
    "a number of 5,000 digits": (claims_text('"width": 0.5', f'"width": {"9" * 5_000}'), "64 bits"),
    "a key of JSON twice": (
        claims_text('"format": 2', '"format": 2, "format": 2'),
        "'format' twice",
    ),
    "a number as text": (
        claims_text('"format": 2', '"format": "2"'),
        "format: Input should be a va",
    ),
    "a lone surrogate": (
        claims_text('"width"', '"\\ud800"'),
        "as sada-gym writes it, got a differ",
    ),
    "bytes that are no UTF-8": (
        extra(f"{GROUP}.json", b"\xff\xfe{}"),
        "Expected UTF-8 in .*, got something else at byte 0",
    ),
    "an edited experiment": (
        claims_text('"budget": 1000', '"budget": 999'),
        "instead of editing it",
    ),
    "a field of measures too many": (measures(rank=1), "rank: Extra inputs"),
    "an unknown track": (
        experiment("target", track="SADA-Moon-v0"),
        "Expected the track to be one of",
    ),
    "a track that escapes": (
        experiment("target", track="../../etc"),
        "Expected ..-..-etc.paper-budgets to be of today's track.*: Expected the track to be",
    ),
    "a track to be imported": (
        experiment("target", track="antigravity:Moon-v0"),
        "Expected the track to be one",
    ),
    "a general id": (
        experiment("target", track="SADA-Digits-v0"),
        "Expected the track to be one of",
    ),
    "an agent that is not shipped": (
        experiment("target", agent="mine"),
        "Expected no agent's name on",
    ),
    "an agent in a file": (
        experiment("target", track="SADA-Digits-3-v0", agent="../weights.safetensors"),
        "Expected the agent on SADA-Digits-3-v0 to be one of cnn",
    ),
    "an unknown rule": (experiment("protocol", rule="no-limit"), "Expected the rule to be one of"),
    "a budget of one's own": (
        experiment("protocol", budget=10**6),
        "budget was 1000000 and is 1000",
    ),
    "fewer samples": (experiment("protocol", samples=10), "samples was 10 and is 250"),
    "an easier threshold": (
        experiment("target", fooling_threshold=0.9),
        "fooling_threshold was 0.9 and is 0.3",
    ),
    "an older version": (experiment("target.application", version=-1), "version was -1 and is 0"),
    "another agent's weights": (
        experiment("target.application", fingerprint="f"),
        "fingerprint was 'f' and is ''",
    ),
    "other settings": (
        experiment("target.application", settings={"noise": 1}),
        "application.settings.dimension",
    ),
    "a reference set of one's own": (
        experiment(
            "target", reference={"sha256": "", "points": 9, "fooling": 9, "uniform_rate": 0.5}
        ),
        "reference was",
    ),
    "options that were not used": (
        experiment("adversary", resolved={}),
        "Expected resolved options that hold",
    ),
    "no seeds": (result(lambda result: result.update(seeds=[])), "Expected at least one seed for"),
    "more queries than allowed": (
        seed(queries=1_001),
        f"Expected at most 1,000 queries, .*, {OF_SEED_1}",
    ),
    "negative queries": (seed(queries=-1), "seeds.1.queries: Input should be greater"),
    "the best seeds": (seed(seed=7), "Expected the seeds 0, 1, 2 and so on for .*, got .0, 7."),
    "seeds out of order": (
        result(lambda result: result["seeds"].reverse()),
        "Expected ascending seeds of .*, each once",
    ),
    "an error beside measures": (
        seed(error="none"),
        f"Expected either measures or an error {OF_SEED_1}, got both",
    ),
    "neither error nor measures": (
        seed(measures=None),
        f"measures or an error {OF_SEED_1}, got neither",
    ),
    "a search of other queries": (
        seed(search={"queries": 5, "fooled": 1, "curve": []}),
        f"Expected a search of 900 queries {OF_SEED_1}",
    ),
    "a newer sada_gym": (
        seed(packages={"sada_gym": "99.0"}),
        "Expected sada_gym .* or older for seed 1",
    ),
    "no sada_gym": (seed(packages={}), "Expected the version of sada_gym among the packages"),
    "markup for a version": (
        seed(packages={"<b>": "1"}),
        "Expected names and versions of packages",
    ),
    "a better AFR": (measures(afr=1.0), f"Expected afr = .*, as the samples give it, {OF_SEED_1}"),
    "more fooled": (
        measures(fooled=250),
        f"Expected fooled = .*, as the samples give it, {OF_SEED_1}",
    ),
    "a narrower interval": (measures(afr_interval_95=[0.5, 0.5]), r"Expected afr_interval_95.0 ="),
    "a lower score": (measures(mean_score=0.0), f"Expected mean_score = .*, {OF_SEED_1}"),
    "a wider spread": (
        measures(mu_std=1.0),
        f"Expected mu_std = .*, as the samples give it, {OF_SEED_1}",
    ),
    "coverage without a reference set": (
        measures(coverage=1.0),
        f"Expected no coverage, .*, {OF_SEED_1}",
    ),
    "negative novelty": (
        measures(novelty={"median": -1.0, "fifth_percentile": 0.0, "minimum": 0.0, "repeats": 0}),
        f"Expected no negative numbers {OF_SEED_1}",
    ),
    "feasible worlds that are not there": (
        measures(feasible={"worlds": 9_999, "fooled": 1, "afr": 0.1}),
        f"Expected at most 250 feasible worlds {OF_SEED_1}",
    ),
    # several results in a file
    "a result twice": (result_twice, "Expected ascending results in .*, each once, got"),
    "results of two adversaries": (
        joined(rule="equal-queries", adversary="other-method"),
        "one adversary .* got the adversary 'my-method' in .* beside 'other-method' in .*json",
    ),
    "results of two presets": (
        joined(rule="equal-queries", preset="paper"),
        "one adversary .* got the preset None in .* beside 'paper' in .*json",
    ),
    "results of two sets of options": (
        joined(rule="equal-queries", options={"width": 0.6}),
        "one adversary .* got the options {'width': 0.5} in .* beside {'width': 0.6} in .*json",
    ),
    "a result in the file of another application": (
        second_application,
        "Expected the results on SADA-Digits in a file called SADA-Digits.json",
    ),
    "a file of an application that is not its track's": (
        experiment("target.application", name="SADA-Digits"),
        "name was 'SADA-Digits' and is 'SADA-Analytic'",
    ),
    "a place in the files of two applications": (
        place_twice,
        "name was 'SADA-Other' and is 'SADA-Analytic'",
    ),
    "no result in a file": (
        claims(lambda content: content.update(results=[])),
        "Expected at least one result in .*json",
    ),
    "a seed of the experiment": (
        experiment("", seed=0),
        "expected no seed of the experiment of all seeds, got 0",
    ),
    # the samples
    "a pickle": (
        pickle_for_archive,
        "Expected an NPZ file with groups GROUP.KIND of the arrays seeds",
    ),
    "an array of objects": (pickled, "mu of dtype object"),
    "a bomb": (bomb, "seeds is compressed|mu is compressed|score is compressed"),
    "compressed arrays": (arrays(dict.copy, np.savez_compressed), "is compressed"),
    "an array twice": (member_twice, rf"arrays named {PLACE}.mu, {PLACE}.mu, {PLACE}.score"),
    "an array outside": (member_outside, "arrays named ../../x, SADA"),
    "an array too many": (
        arrays(lambda content: content.update(x=np.zeros(1))),
        rf"named .*, {PLACE}.x",
    ),
    "an array too few": (
        arrays(lambda content: content.pop("seeds")),
        rf"named {PLACE}.mu, {PLACE}.score\)",
    ),
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
        lambda folder: os.truncate(folder / f"{GROUP}.npz", 4_000),
        "it is damaged",
    ),
    "mu of double precision": (
        retyped("mu", np.float64),
        "mu of dtype float64|bytes for the samples of 2",
    ),
    "scores of single precision": (retyped("score", np.float32), "score of dtype float32"),
    "big-endian mu": (retyped("mu", ">f4"), "mu of dtype >f4"),
    "unsigned seeds": (retyped("seeds", np.uint64), "seeds of dtype uint64"),
    "one column": (
        arrays(lambda content: content.update(mu=content["mu"][:, :1])),
        r"mu of shape \(250, 2\)",
    ),
    "flat mu": (
        arrays(lambda content: content.update(mu=content["mu"][:, 0])),
        r"mu of dtype .* \(500,\)",
    ),
    "rows that do not match": (
        arrays(lambda content: content.update(score=content["score"][1:])),
        "Expected as many samples of each seed of .*, got 2 seeds, 500 mu and 499 scores",
    ),
    "a sample too few": (
        arrays(lambda content: content.update({n: content[n][2:] for n in ("mu", "score")})),
        r"Expected mu of shape \(250, 2\) of each seed for .*, got \(249, 2\)",
    ),
    "samples of no seed": (
        put("seeds", 1, 9),
        r"Expected samples of the seeds .0, 1., as claimed, for",
    ),
    "a NaN for mu": (put("mu", (3, 1), np.nan), rf"Expected mu within \[-1, 1\] {OF_SEED_0}"),
    "mu outside the box": (put("mu", (3, 1), 1.01), rf"Expected mu within \[-1, 1\] {OF_SEED_0}"),
    "an infinite score": (
        put("score", 3, -np.inf),
        rf"Expected scores within \[0, 1\] {OF_SEED_0}",
    ),
    "a score above 1": (put("score", 3, 1.5), rf"Expected scores within \[0, 1\] {OF_SEED_0}"),
    "the seeds in another order": (
        put("seeds", slice(None), [1, 0]),
        "Expected ascending seeds of .*, each once, got .1, 0.",
    ),
    "a seed of samples twice": (
        put("seeds", 1, 0),
        "Expected ascending seeds of .*, each once, got .0, 0.",
    ),
    "a negative seed of samples": (put("seeds", 0, -1), "Expected seeds of .* from 0 up, got -1"),
    "no seeds of samples": (
        arrays(lambda content: content.update(seeds=content["seeds"][:0])),
        "Expected as many samples of each seed of .*, got 0 seeds",
    ),
    "samples of a place that nothing is claimed of": (
        placed(f"{ANALYTIC}.equal-queries", keep=True),
        "Expected samples of .*, as claimed, in .*, got .*equal-queries",
    ),
    "samples of another place": (
        placed(f"{ANALYTIC}.equal-queries", keep=False),
        "Expected samples of .*, as claimed, in .*, got ..SADA-Analytic-v0.equal-queries",
    ),
    "a place that a terminal obeys": (
        placed("\x1b[2J\u202e", keep=True),
        r"Expected samples of .*, as claimed, in .*, got .*x1b\[2J",
    ),
    "a place that leads out": (
        placed("../../etc/passwd", keep=True),
        "Expected samples of .*, as claimed, in .*, got .'../../etc/passwd'",
    ),
    "a place without a name": (placed("", keep=True), "Expected samples of .*, got .'', 'SADA"),
    "better scores": (
        put("score", slice(0, 250), 0.0),
        "Expected fooled = 250, as the samples give it, for seed 0",
    ),
}


def snapshot(folder):
    """Everything below a folder, without following links."""
    statuses = {str(path): path.lstat() for path in sorted(folder.rglob("*"))}
    return {path: (s.st_mode, s.st_size, s.st_mtime_ns) for path, s in statuses.items()}


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
    metadata("My method", text)(folder)
    metadata("Ada L.", text)(folder)
    check_entry(folder)


def test_a_few_seconds_of_fuzzing_find_no_crash(tmp_path):
    report = fuzz(tmp_path, seconds=2, seed=1, least=60)
    assert report.crashes == []
    assert report.refused > 30
