"""Draw docs/images/gallery-*.png, one an environment: `python -m tools.draw_gallery [name ...]`.

Each shows how an agent fails. Of 48 uniform worlds, detection takes the one where the detector is
most sure of another class, driving and racing the one with the lowest score.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps

from sada_gym import Application, make_application
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.digits.base import RIGHT, WRONG, enlarged
from sada_gym.envs.flight import frame as flight_frame
from sada_gym.envs.go2 import frame as go2_frame
from sada_gym.envs.metadrive import frame as metadrive_frame
from sada_gym.envs.pixel import PixelApplication
from sada_gym.envs.quadrotor import frame as quadrotor_frame
from sada_gym.envs.robot.application import RobotApplication
from sada_gym.envs.robot.frame import snapshot
from tools import draw_flight, draw_go2, draw_metadrive, draw_quadrotor
from tools.draw_digits import gradient_sign
from tools.draw_robot import SEED as ROBOT_SEED
from tools.draw_robot import TURNED, mu_of

IMAGES = Path(__file__).parents[1] / "docs" / "images"
WIDTH, HEIGHT, INSET = 480, 300, 150
WORLDS = 48
PAPER, FONT = (255, 255, 255), ImageFont.load_default(22)


def uniform(application: Application, n: int = WORLDS) -> tuple[np.ndarray, list[int]]:
    """Uniform mu, (n, d), and their seeds."""
    rng = np.random.default_rng(2)
    return rng.uniform(-1.0, 1.0, (n, len(application.parameters))), list(range(n))


def card(picture: Image.Image) -> Image.Image:
    """Fill the size of a card."""
    return ImageOps.fit(picture.convert("RGB"), (WIDTH, HEIGHT))


def tag(picture: Image.Image, text: str, colour: tuple[int, int, int]) -> None:
    """Write into the lower left corner."""
    draw = ImageDraw.Draw(picture)
    box = draw.textbbox((12, HEIGHT - 36), text, font=FONT)
    draw.rectangle((box[0] - 6, box[1] - 5, box[2] + 6, box[3] + 5), fill=colour)
    draw.text((12, HEIGHT - 36), text, fill=PAPER, font=FONT)


def detection() -> Image.Image:
    """A car that the detector takes for something else, in its box."""
    return mistaken(DetectionApplication("car"))


def detection_coco() -> Image.Image:
    """A textured car that a detector of photographs takes for something else."""
    return mistaken(make_application("SADA-DetectionCoco-Car-v0"))


def mistaken(application: Application) -> Image.Image:
    """The world in which a detector is most sure of another class."""
    assert isinstance(application, DetectionApplication)
    mu, seeds = uniform(application)
    infos = application.evaluate(mu, seeds).infos
    best = [max(info["detections"], key=lambda one: one["score"], default=None) for info in infos]
    sure = [
        one["score"] if one and info["fooled"] else 0.0
        for one, info in zip(best, infos, strict=True)
    ]
    worst = int(np.argmax(sure))
    scene = application.scene(application.parameters.validate(mu[[worst]])[0], seeds[worst])
    picture = Image.fromarray(default_renderer().render(scene, WIDTH).image)
    scale = WIDTH / application.image_size
    left, top, right, bottom = (float(edge) * scale for edge in best[worst]["box"])
    ImageDraw.Draw(picture).rectangle((left, top, right, bottom), outline=WRONG, width=4)
    above = round(min(max((top + bottom - HEIGHT) / 2, 0), WIDTH - HEIGHT))
    picture = picture.crop((0, above, WIDTH, above + HEIGHT))
    tag(picture, f"seen as a {application.class_names[best[worst]['label']]}", WRONG)
    return picture


def with_map(env_id: str, camera: tuple[int, ...], plan: tuple[int, ...]) -> Image.Image:
    """The camera's picture of the worst world, and the map in its lower right corner."""
    application = make_application(env_id)
    mu, seeds = uniform(application)
    worst = int(application.evaluate(mu, seeds).score.argmin())
    frame = Image.fromarray(application.render(mu[worst], seeds[worst]))
    picture = card(frame.crop(camera))
    inset = ImageOps.fit(frame.crop(plan), (INSET, INSET))
    picture.paste(ImageOps.expand(inset, 2, PAPER), (WIDTH - INSET - 12, HEIGHT - INSET - 12))
    return picture


def robot() -> Image.Image:
    """The end of the robot's first trip: a collision."""
    rollout = RobotApplication().rollouts(mu_of(TURNED), ROBOT_SEED)[0]
    return card(snapshot(rollout, len(rollout["poses"]) - 1))


def quadrotor() -> Image.Image:
    """The end of a flight that shakes."""
    application = make_application(draw_quadrotor.TRACK)
    mu = draw_quadrotor.mu_of(**draw_quadrotor.SHAKING)
    (rollout,) = application.rollouts(mu, draw_quadrotor.SEED)
    return card(quadrotor_frame.snapshot(rollout, rollout.last).crop((80, 10, 640, 360)))


def metadrive() -> Image.Image:
    """The end of a drive that fails."""
    application = make_application("SADA-DrivingMetaDrive-v0")
    seed = draw_metadrive.FAILED
    (rollout,) = application.rollouts(draw_metadrive.uniform(seed), seed)
    return card(metadrive_frame.snapshot(rollout, rollout.last))


def go2() -> Image.Image:
    """The end of a walk that slides back."""
    application = make_application(draw_go2.TRACK)
    (rollout,) = application.rollouts(draw_go2.mu_of(**draw_go2.SLOW), draw_go2.SEED)
    return card(go2_frame.snapshot(rollout, rollout.last).crop((90, 30, 650, 380)))


def flight() -> Image.Image:
    """The end of a flight that stalls."""
    application = make_application(draw_flight.TRACK)
    (rollout,) = application.rollouts(draw_flight.mu_of(**draw_flight.SINKING), draw_flight.SEED)
    return card(flight_frame.snapshot(rollout, rollout.last).crop((0, 0, 560, 350)))


def digits() -> Image.Image:
    """The first fifteen uniform worlds that fool."""
    cell, columns, rows = 92, 5, 3
    application = DigitsApplication()
    mu, seeds = uniform(application, 200)
    fooled = np.flatnonzero(application.evaluate(mu, seeds).fooled)
    whole = Image.new("RGB", (WIDTH, HEIGHT), PAPER)
    for k, world in enumerate(fooled[: columns * rows]):
        image = Image.fromarray(enlarged(application.attacked_image(mu[world], seeds[world])[1]))
        image = image.resize((cell, cell), Image.Resampling.NEAREST)
        whole.paste(image, (k % columns * (cell + 5), k // columns * (cell + 12)))
    return whole


def pixel() -> Image.Image:
    """An image, and the same with noise along the gradient."""
    application = PixelApplication(image=3, radius=0.15)
    side = 232
    whole = Image.new("RGB", (WIDTH, HEIGHT), PAPER)
    draw = ImageDraw.Draw(whole)
    for k, mu in enumerate((np.zeros(64), gradient_sign(application))):
        (info,) = application.evaluate(mu[None], [0]).infos
        image = Image.fromarray(enlarged(application.attacked_image(mu, 0)[1]))
        left = k * (side + 16)
        whole.paste(image.resize((side, side), Image.Resampling.NEAREST), (left, 0))
        colour = WRONG if info["fooled"] else RIGHT
        draw.text((left, side + 14), f"seen as {info['predicted']}", fill=colour, font=FONT)
    return whole


def photos() -> Image.Image:
    """A photograph of a street in which a detector no longer finds the people."""
    frame = np.asarray(Image.open(IMAGES / "own-images.png"))  # tools.draw_photos draws it
    picture = Image.fromarray(frame[:360, 480:]).resize((WIDTH, WIDTH * 3 // 4))
    above = (picture.height - HEIGHT) // 2
    return picture.crop((0, above, WIDTH, above + HEIGHT))


def analytic() -> Image.Image:
    """Q over the plane: four boxes of failures."""
    frame = make_application("SADA-Analytic-v0").render([1, 1], 0)[6:, :-6]  # less the cross
    return Image.fromarray(frame).resize((WIDTH, HEIGHT))


def driving() -> Image.Image:
    """The driver about to leave its lane."""
    return with_map("SADA-Driving-OneCurve-v0", (0, 68, 450, 266), (0, 266, 450, 608))


def uav() -> Image.Image:
    """The pilot on its way to a gate that it will miss."""
    return with_map("SADA-UAV-4Anchors-v0", (0, 0, 512, 384), (512, 0, 896, 384))


def main() -> None:
    """Draw those that are named, or all."""
    drawings = (
        *(detection, detection_coco, photos, driving, uav, robot, quadrotor, go2, metadrive),
        *(flight, digits, pixel),
        analytic,
    )
    for draw in drawings:
        if draw.__name__ in (sys.argv[1:] or [one.__name__ for one in drawings]):
            name = draw.__name__.replace("_", "-")
            draw().save(IMAGES / f"gallery-{name}.png", optimize=True)


if __name__ == "__main__":
    main()
