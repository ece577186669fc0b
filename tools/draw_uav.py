"""Draw the pictures of docs/environments/uav.md into docs/images: `python -m tools.draw_uav`.

`--pilot` names another pilot than the shipped one, or a file of weights.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym import agents
from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.camera.pinhole import camera
from sada_gym.envs.uav.episodes import RacingStart
from sada_gym.envs.uav.frame import TrackMap, summary
from sada_gym.envs.uav.world.track import TEMPLATES, line

IMAGES = Path(__file__).parents[1] / "docs" / "images"
CELL, LABEL, TRACKS = 220, 24, 4
PICTURE = 384
"""Pixels: a summary's height without its text, which captions say."""
INK = (31, 41, 51)


def grid(rows: list[list[tuple[str, Image.Image]]]) -> Image.Image:
    """Pictures in rows, each with a line of text above it."""
    width, height = rows[0][0][1].size
    whole = Image.new("RGB", (len(rows[0]) * width, len(rows) * (height + LABEL)), "white")
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(14)
    for i, row in enumerate(rows):
        for j, (text, picture) in enumerate(row):
            draw.text((j * width + 6, i * (height + LABEL) + 4), text, fill=INK, font=font)
            whole.paste(picture, (j * width, i * (height + LABEL) + LABEL))
    return whole


def plan(anchors: int, mu: np.ndarray) -> Image.Image:
    """A track from above."""
    track = TEMPLATES[anchors].tracks(mu[None])
    return TrackMap(track.gates[0], line(track.anchors[0]), CELL).picture()


def tracks(rng: np.random.Generator) -> Image.Image:
    """The templates, each beside random tracks."""
    rows = []
    for anchors, template in TEMPLATES.items():
        d = len(template.parameters)
        row = [(f"{anchors} anchors, undisturbed", plan(anchors, np.zeros(d)))]
        row += [("uniform mu", plan(anchors, rng.uniform(-1, 1, d))) for _ in range(TRACKS)]
        rows.append(row)
    return grid(rows)


def seen(application: UAVApplication) -> Image.Image:
    """What the pilot sees: a moment each of five races, large and as the pilot gets it."""
    large, small = camera(CELL * 3 // 4, CELL), camera()
    rows = [[], []]
    for seed, share in ((1, 0.05), (2, 0.3), (3, 0.5), (4, 0.7), (5, 0.9)):
        (rollout,) = application.rollouts(np.zeros(len(application.parameters)), seed)
        step = int(share * len(rollout["states"]))
        state = rollout["states"][[step]]
        gates = rollout.start.gates[None]
        (fine,) = large.draw(gates, state, [seed])
        (coarse,) = small.draw(gates, state, [seed])
        rows[0].append((f"{rollout['time_s'][step]:.1f} s", fine))
        rows[1].append(("as the pilot gets it", coarse))
    size = (CELL, CELL * 3 // 4)
    return grid(
        [
            [(t, Image.fromarray(p).resize(size, Image.Resampling.NEAREST)) for t, p in r]
            for r in rows
        ]
    )


def rollouts(
    application: UAVApplication, rng: np.random.Generator
) -> tuple[Rollout[RacingStart], Rollout[RacingStart] | None]:
    """A race without a miss and one below the threshold, of uniform mu, the first of each."""
    mu = rng.uniform(-1, 1, (64, len(application.parameters)))
    outcomes = application.evaluate(mu, list(range(len(mu))))
    passed = int((outcomes.score == 1).argmax())
    (rollout,) = application.rollouts(mu[passed], passed)
    assert rollout.score == 1, "No race of 64 without a miss."
    if not outcomes.fooled.any():
        return rollout, None
    failed = int(outcomes.fooled.argmax())
    return rollout, application.rollouts(mu[failed], failed)[0]


def main() -> None:
    """Draw all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pilot", default="ppo")
    parser.add_argument("--out", type=Path, default=IMAGES)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    pictures = {"tracks": tracks(rng)}
    application = UAVApplication(4, agent=agents.load(arguments.pilot, "SADA-UAV"))
    pictures["seen"] = seen(application)
    passed, failed = rollouts(application, rng)
    pictures["passed"] = Image.fromarray(summary([passed])[:PICTURE])
    if failed is not None:
        pictures["failed"] = Image.fromarray(summary([failed])[:PICTURE])
    for name, picture in pictures.items():
        picture.save(arguments.out / f"uav-{name}.png", optimize=True)


if __name__ == "__main__":
    main()
