"""The colour of the sky: sun, clouds, and the hills at its foot."""

from __future__ import annotations

import math

from sada_gym.envs.driving.world.weather import Light
from sada_gym.envs.pixels import Triple, clip, mix, periodic, plus, scaled, times
from sada_gym.foundations.arrays import Floats32
from sada_gym.foundations.compiled import inlined


@inlined
def sky_colour(clouds: Floats32, dx: float, dy: float, slope: float, light: Light) -> Triple:
    """Return the colour of the sky, and of the hills at its foot, in a direction."""
    rise = slope / math.sqrt(1 + slope * slope)
    colour = mix(light.horizon, light.zenith, clip(1.3 * math.sqrt(max(rise, 0.0))))
    flat = 1.0 / (max(slope, 0.0) + 0.07)
    noise = periodic(clouds, 9.0 * dx * flat + 40.0, 9.0 * dy * flat + 40.0)
    share = clip(3.0 * (noise - 1.0 + light.cover)) if light.cover < 1.0 else 1.0
    shade = 0.82 + 0.36 * noise if light.cover >= 1.0 else 1.0
    cloud = scaled(light.cloud, shade)
    fade = clip(6.0 * slope)  # clouds melt into the haze low down
    colour = mix(colour, cloud, 0.85 * share * (0.35 + 0.65 * fade))
    cosine = (dx * light.sun_x + dy * light.sun_y + slope * light.sun_z) * (
        rise / slope if slope > 1e-9 else 1.0
    )
    if cosine > 0.8:
        glow = cosine**24
        disc = 9.0 * clip(1200.0 * (cosine - 0.9985))
        power = (0.45 * glow + disc) * (1.0 - light.cover)
        colour = plus(colour, light.sun, power)
    # no hill is higher than 0.047: most of the sky need not ask
    if slope < 0.047 and slope < 0.012 + 0.035 * periodic(clouds, 20.0 * dx, 20.0 * dy):
        wood = times((0.05, 0.08, 0.05), light.ambient)
        colour = mix(wood, light.horizon, 1.0 - math.exp(-450.0 * light.haze))
    return colour
