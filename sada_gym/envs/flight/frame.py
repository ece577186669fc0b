"""Pictures of a flight for people: the attitude, the way from above, altitude and heading."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.flight.start import (
    COMMAND_S,
    FLIGHT_S,
    PARAMETERS,
    POLICY_HZ,
    SETTLED_S,
    START_DEG,
    START_FT,
    WITHIN_DEG,
    WITHIN_FT,
    FlightEnd,
    FlightStart,
)
from sada_gym.envs.flight.world.engine import FIELDS
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, beside, caption, cross, dashed, font, stacked
from sada_gym.foundations.frames import BLUE, GREEN, VERMILLION, Frame, LegendEntry, rgb

WIDTH, UPPER, CHART = 720, 260, 120
_FINE = 2
"""Pictures are drawn larger by this factor and then made smaller, so that edges are smooth."""
_SKY, _EARTH, _MAP, _GRID = (111, 168, 220), (160, 120, 74), (236, 242, 232), (206, 216, 200)
_FLOWN, _COMMANDED, _FAILED, _HELD = rgb(BLUE), rgb(GREEN), rgb(VERMILLION), (214, 240, 224)
_YELLOW = (250, 204, 21)
_LEFT, _RIGHT, _TEXT = 104, 32, 17
_DEGREE = 3.2
"""Pixels of a degree of pitch."""
_AEROPLANE = ((1.0, 0.0), (0.2, 0.12), (0.1, 0.9), (-0.15, 0.9), (-0.2, 0.12), (-0.75, 0.08))
_TAIL = ((-0.8, 0.35), (-0.95, 0.35), (-0.95, 0.0))
"""Half an aeroplane from above: ahead, and to the right, in halves of its length."""

LEGEND = (
    LegendEntry("commanded", GREEN, "dashed line"),
    LegendEntry("flown", BLUE, "line"),
    LegendEntry("within 100 ft and 10° when that counts", "#d6f0e0", "square"),
    LegendEntry("failed here", VERMILLION, "cross"),
    LegendEntry(
        "Above: the attitude, and the way from above, its last part. Below: altitude and heading "
        "over time."
    ),
)


def summary(rollouts: Sequence[Rollout[FlightStart]]) -> Frame:
    """Draw the end of the flight, with what happened and the conditions."""
    (rollout,) = rollouts
    values = rollout.start.conditions.values()
    lines = PARAMETERS.lines(values, 4)
    end = FlightEnd(int(rollout["told"][-1, 3])).name.lower()
    title = (
        f"{rollout.start.built.title} at {rollout.start.speed_kt:.0f} kt: {end} after "
        f"{rollout.last / POLICY_HZ:.0f} s, held for {rollout.score:.0%} of the time"
    )
    text = caption("\n".join([title, *lines]), WIDTH, _TEXT)
    return stacked([text, snapshot(rollout, rollout.last)])


def picture(rollouts: Sequence[Rollout[FlightStart]], i: int, step: int) -> tuple[Image.Image, str]:
    """Draw a step of flight i, and say when that is."""
    now = dict(zip(FIELDS, rollouts[i]["states"][step].tolist(), strict=True))
    text = (
        f"{step / POLICY_HZ:3.0f} s   {now['speed_kt']:.0f} kt   {now['altitude_ft']:,.0f} ft   "
        f"{now['heading_deg']:.0f}°   bank {now['bank_deg']:.0f}°   throttle {now['throttle']:.0%}"
    )
    return snapshot(rollouts[i], step), text


def observation(rollout: Rollout[FlightStart], step: int = 0) -> Frame:
    """Draw the attitude, and where the aircraft is, after some steps."""
    commanded = rollout["commands"][step]
    return draw_frame(rollout.start, rollout["states"][step], (commanded[0], commanded[1]))


def draw_frame(start: FlightStart, state: Floats, commanded: tuple[float, float]) -> Frame:
    """Draw an aircraft in a state, see `FIELDS`, and the heading that is commanded."""
    return np.asarray(_upper(start, state[None], commanded[1], failed=False))


def snapshot(rollout: Rollout[FlightStart], step: int) -> Image.Image:
    """Draw a step of a flight with the way until then, above altitude and heading over time."""
    states, commands = rollout["states"][: step + 1], rollout["commands"]
    failed = rollout["told"][step, 3] > FlightEnd.FLOWN
    altitude, headings = states[:, :2].T
    turned = np.rad2deg(np.unwrap(np.deg2rad(headings)))
    start = rollout.start
    charts = [
        _chart(altitude, START_FT, start.altitude_ft, WITHIN_FT, " ft", failed),
        _chart(turned, START_DEG, start.heading_deg, WITHIN_DEG, "°", failed),
    ]
    upper = _upper(start, states, float(commands[step, 1]), failed=bool(failed))
    return Image.fromarray(stacked([upper, *charts]))


def _upper(start: FlightStart, states: Floats, heading_deg: float, *, failed: bool) -> Image.Image:
    now = dict(zip(FIELDS, states[-1].tolist(), strict=True))
    attitude = _attitude(now["bank_deg"], now["pitch_deg"], now["speed_kt"], now["altitude_ft"])
    return beside(attitude, _plan(start, states, heading_deg, failed=failed))


def _attitude(bank_deg: float, pitch_deg: float, speed_kt: float, feet: float) -> Image.Image:
    """Draw what the attitude indicator shows, with speed and altitude."""
    size = UPPER * _FINE
    half, degree = size / 2, _DEGREE * _FINE
    drawn = Image.new("RGB", (size, size), _SKY)
    draw = ImageDraw.Draw(drawn)
    cosine, sine = math.cos(math.radians(bank_deg)), math.sin(math.radians(bank_deg))

    def at(across: float, degrees: float) -> tuple[float, float]:
        down = (pitch_deg - degrees) * degree
        return half + across * cosine + down * sine, half - across * sine + down * cosine

    draw.polygon([at(-size, 0), at(size, 0), at(size, -200), at(-size, -200)], _EARTH)
    draw.line([at(-size, 0), at(size, 0)], "white", 2 * _FINE)
    for mark in (-30, -20, -10, 10, 20, 30):
        draw.line([at(-half / 4, mark), at(half / 4, mark)], "white", _FINE)
        draw.text(at(half / 3, mark), f"{abs(mark)}", "white", font(17 * _FINE), "mm")
    for side in (-1, 1):
        wing = [(half + side * half * x, half + y) for x, y in ((0.6, 0), (0.2, 0), (0.2, 14))]
        draw.line(wing, INK_RGB, 5 * _FINE)
        draw.line(wing, _YELLOW, 3 * _FINE)
    draw.circle((half, half), 3 * _FINE, _YELLOW, INK_RGB)
    face = font(21 * _FINE, bold=True)
    for text, across, anchor in (
        (f"{speed_kt:.0f} kt", 10 * _FINE, "la"),
        (f"{feet:,.0f} ft", size - 10 * _FINE, "ra"),
    ):
        draw.text((across, 8 * _FINE), text, "white", face, anchor, stroke_width=3, stroke_fill=0)
    return drawn.resize((UPPER, UPPER), Image.Resampling.BOX)


def _plan(start: FlightStart, states: Floats, heading_deg: float, *, failed: bool) -> Image.Image:
    """Draw the way from above, north up, with the aircraft and its commanded heading."""
    width, height = (WIDTH - UPPER) * _FINE, UPPER * _FINE
    drawn = Image.new("RGB", (width, height), _MAP)
    draw = ImageDraw.Draw(drawn)
    way = states[:, [FIELDS.index("east_m"), FIELDS.index("north_m")]]
    pixel = 60.0 * start.speed_kt * 0.5144 / (0.55 * width)  # a minute is half as wide
    here = way[-1]

    def at(east: float, north: float) -> tuple[float, float]:
        return width / 2 + (east - here[0]) / pixel, height / 2 - (north - here[1]) / pixel

    for k in range(-20, 21):
        (across, _), (_, down) = (
            at((here[0] // 1e3 + k) * 1e3, 0),
            at(0, (here[1] // 1e3 + k) * 1e3),
        )
        draw.line([(across, 0), (across, height)], _GRID, _FINE)
        draw.line([(0, down), (width, down)], _GRID, _FINE)
    draw.line([at(*place) for place in way.tolist()], _FLOWN, 3 * _FINE, joint="curve")
    middle, course = at(*here), math.radians(heading_deg)
    tip = middle[0] + width * math.sin(course), middle[1] - width * math.cos(course)
    dashed(draw, [middle, tip], _COMMANDED, 2 * _FINE, 16, 12)
    turned = math.radians(float(states[-1, FIELDS.index("heading_deg")]))
    right = [*_AEROPLANE, *_TAIL]
    outline = [*right, *((ahead, -side) for ahead, side in reversed(right))]
    scale = 26 * _FINE
    draw.polygon(
        [
            (
                middle[0] + scale * (ahead * math.sin(turned) + side * math.cos(turned)),
                middle[1] - scale * (ahead * math.cos(turned) - side * math.sin(turned)),
            )
            for ahead, side in outline
        ],
        INK_RGB,
    )
    if failed:
        cross(draw, middle, 14 * _FINE, _FAILED, (8 * _FINE, 5 * _FINE))
    draw.text((8 * _FINE, 6 * _FINE), "north ↑   grid 1 km", INK_RGB, font(20 * _FINE))
    return drawn.resize((WIDTH - UPPER, UPPER), Image.Resampling.BOX)


def _chart(
    flown: Floats, first: float, commanded: float, within: float, unit: str, failed: bool
) -> Image.Image:
    chart = Image.new("RGB", (WIDTH * _FINE, CHART * _FINE), "white")
    draw, face = ImageDraw.Draw(chart), font(20 * _FINE)
    low = min(first, commanded, flown.min()) - 1.3 * within
    high = max(first, commanded, flown.max()) + 1.3 * within

    def at(time_s: float, value: float) -> tuple[float, float]:
        across = _LEFT + (WIDTH - _LEFT - _RIGHT) * time_s / FLIGHT_S
        return _FINE * across, _FINE * (CHART - 32 - (CHART - 42) * (value - low) / (high - low))

    box = [at(SETTLED_S, commanded + within), at(FLIGHT_S, commanded - within)]
    draw.rectangle([*box[0], *box[1]], _HELD)
    steps = [at(0, first), at(COMMAND_S, first), at(COMMAND_S, commanded), at(FLIGHT_S, commanded)]
    dashed(draw, steps, _COMMANDED, 2 * _FINE, 12, 9)
    draw.line([at(0, high), at(0, low), at(FLIGHT_S, low)], INK_RGB, _FINE)
    points = [at(k / POLICY_HZ, value) for k, value in enumerate(flown.tolist())]
    draw.line(points, _FLOWN, 2 * _FINE, joint="curve")
    if failed:
        cross(draw, points[-1], 6 * _FINE, _FAILED, (5 * _FINE, 3 * _FINE))
    far = abs(commanded - first) > 0.2 * (high - low)
    for value in {first, commanded} if far else {commanded}:
        across, down = at(0, value)
        draw.text((across - 8, down), f"{value:,.0f}{unit}", INK_RGB, face, "rm")
    for time_s in range(0, FLIGHT_S + 1, 20):
        across, down = at(time_s, low)
        draw.text((across, down + 6), f"{time_s} s", INK_RGB, face, "mt")
    return chart.resize((WIDTH, CHART), Image.Resampling.BOX)
