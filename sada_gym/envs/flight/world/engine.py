"""JSBSim with one aircraft in the air: its files, its load, its trim, and the air around it.

The aircraft's file is read from the package, and a copy gets three additions: servos between the
autopilot and the controls, which can be slow or stuck; ice, as forces that take lift away and add
drag; and, where the file leaves the autopilot's command for the ailerons unconnected (the Global
5000's does), that connection.
"""

from __future__ import annotations

import math
import tempfile
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sada_gym.envs.flight.start import (
    AIRCRAFT,
    COMMAND_S,
    POLICY_HZ,
    START_DEG,
    START_FT,
    FlightStart,
)

RATE_HZ = 60
"""The simulation's steps in a second."""
ICE_S, WIND_S = 30.0, 20.0
"""The time in which ice builds up, and in which wind rises after the command."""
_PROPORTIONAL, _INTEGRAL, _POWER = 0.02, 0.0005, 0.7
"""The crew's hand on the throttle: a share of it for each knot too slow, and for each second of one
knot; and where it is before the trim."""
_LATITUDE_DEG, _NORTH_M, _EAST_M = 40.0, 111_035.0, 85_394.0
"""Where flights begin, and the metres of a degree there."""
_FPS_PER_KT = 1.6878099
_READ = {
    "altitude_ft": "position/h-sl-ft",
    "heading_deg": "attitude/psi-deg",
    "speed_kt": "velocities/vc-kts",
    "bank_deg": "attitude/phi-deg",
    "pitch_deg": "attitude/theta-deg",
    "alpha_rad": "aero/alpha-rad",
    "climb_fps": "velocities/h-dot-fps",
    "roll_rad_s": "velocities/p-rad_sec",
    "pitch_rad_s": "velocities/q-rad_sec",
    "yaw_rad_s": "velocities/r-rad_sec",
    "throttle": "fcs/throttle-pos-norm",
    "north_m": "position/lat-geod-deg",
    "east_m": "position/long-gc-deg",
}
FIELDS = (*_READ,)
"""The numbers of a state, in this order."""

_SERVOS = """
<system name="servos">
  <property value="0.0"> world/servo-rate </property>
  <channel name="servos">
    <actuator name="fcs/servo-pitch">
      <input> ap/elevator_cmd </input> <rate_limit> world/servo-rate </rate_limit>
    </actuator>
    <actuator name="fcs/servo-roll">
      <input> {roll} </input> <rate_limit> world/servo-rate </rate_limit>
    </actuator>
  </channel>
</system>
"""
_ICE = """
<external_reactions>
  <property value="0.0"> world/lost-lift </property>
  <property value="0.0"> world/added-drag </property>
  <force name="lost-lift" frame="WIND">
    <function><product>
      <p> world/lost-lift </p> <p> forces/fwz-aero-lbs </p>
    </product></function>
    {place} <direction> <x> 0 </x> <y> 0 </y> <z> 1 </z> </direction>
  </force>
  <force name="added-drag" frame="WIND">
    <function><product>
      <p> world/added-drag </p> <p> forces/fwx-aero-lbs </p>
    </product></function>
    {place} <direction> <x> -1 </x> <y> 0 </y> <z> 0 </z> </direction>
  </force>
</external_reactions>
"""


class Flight:
    """One aircraft in the air, trimmed for level flight, with the autopilot off.

    Attributes:
        fault: Why the world is invalid; empty where it is not.
    """

    def __init__(self, start: FlightStart) -> None:
        self.start, self.fault, self._step = start, "", 0
        self._fdm = fdm = _load(start.aircraft)
        built, now = start.built, start.conditions
        # its generator takes 0 for 1, and neighbours begin alike
        mixed = np.random.default_rng(start.seed).integers(1, 2**31 - 1)
        fdm["simulation/randomseed"] = int(mixed)
        fdm["atmosphere/delta-T"] = 1.8 * now["temperature_k"]
        self._put_load()
        for name, value in (
            ("ic/terrain-elevation-ft", 0.0),
            ("ic/lat-geod-deg", _LATITUDE_DEG),
            ("ic/long-gc-deg", 0.0),
            ("ic/h-sl-ft", START_FT),
            ("ic/psi-true-deg", START_DEG),
            ("ic/vc-kts", start.speed_kt),
            ("ic/gamma-deg", 0.0),
        ):
            fdm[name] = value
        self._trim()
        nodes = fdm.get_property_manager()
        self._read = [nodes.get_node(path).get_double_value for path in _READ.values()]
        self._set = {
            name: nodes.get_node(path).set_double_value
            for name, path in (
                ("lost_lift", "world/lost-lift"),
                ("added_drag", "world/added-drag"),
                ("wind", "atmosphere/wind-east-fps"),
                ("down", "atmosphere/wind-down-fps"),
                ("stuck", "fcs/servo-pitch/malfunction/fail_stuck"),
                ("elevator", "fcs/elevator-cmd-norm"),
                ("aileron", "fcs/aileron-cmd-norm"),
                ("rudder", "fcs/rudder-cmd-norm"),
            )
        }
        self._wanted_kt = start.speed_kt
        self._speed_kt = self._read[FIELDS.index("speed_kt")]
        self._levers = [
            nodes.get_node(f"fcs/throttle-cmd-norm[{i}]").set_double_value
            for i in range(built.engines)
        ]
        fdm["world/servo-rate"] = 2.0 / now["servo_s"]
        fdm["atmosphere/turb-type"] = 3
        fdm["atmosphere/turbulence/milspec/severity"] = min(math.floor(now["turbulence"] + 0.5), 4)
        self.command(START_FT, START_DEG)

    def _put_load(self) -> None:
        """Give the aircraft its weight and its centre of gravity by one point mass."""
        fdm, built, now = self._fdm, self.start.built, self.start.conditions
        for i in range(built.masses):
            fdm[f"inertia/pointmass-weight-lbs[{i}]"] = 0.0
        fdm.run_ic()
        bare_lb, bare_in = fdm["inertia/weight-lbs"], fdm["inertia/cg-x-in"]
        least_lb = bare_lb + built.crew_lb
        weight_lb = least_lb + now["payload"] * (built.most_lb - least_lb)
        weights_lb, limits_in = zip(*built.forward_in, strict=True)
        forward_in = float(np.interp(weight_lb, weights_lb, limits_in))
        cg_in = forward_in + now["balance"] * (built.aft_in - forward_in)
        load_lb = weight_lb - bare_lb
        fdm["inertia/pointmass-weight-lbs"] = load_lb
        x_in = (cg_in * weight_lb - bare_in * bare_lb) / load_lb
        fdm["inertia/pointmass-location-X-inches"] = x_in
        fdm["inertia/pointmass-location-Y-inches"] = 0.0

    def _trim(self) -> None:
        """Begin level flight with the engines running, by JSBSim's trim where it has one."""
        from jsbsim import TrimFailureError

        fdm, built = self._fdm, self.start.built
        fdm.run_ic()
        fdm["gear/gear-cmd-norm"] = fdm["gear/gear-pos-norm"] = 0.0  # the C172's stays out
        for i in range(built.engines):
            fdm[f"fcs/mixture-cmd-norm[{i}]"] = 0.87
            fdm[f"fcs/advance-cmd-norm[{i}]"] = built.advance
            fdm[f"fcs/throttle-cmd-norm[{i}]"] = _POWER
        fdm["propulsion/set-running"] = -1
        if built.trims:
            try:
                fdm["simulation/do_simple_trim"] = 1
            except TrimFailureError:
                self.fault = "JSBSim finds no trim for level flight"
        self._power = fdm["fcs/throttle-cmd-norm"]

    def engage(self) -> None:
        """Switch the autopilot on."""
        for name in self.start.built.engage:
            self._fdm[name] = 1.0

    def command(self, altitude_ft: float, heading_deg: float) -> None:
        """Tell the autopilot where to fly."""
        self._fdm["ap/altitude_setpoint"] = altitude_ft
        self._fdm["ap/heading_setpoint"] = heading_deg
        self._fdm["guidance/specified-heading-rad"] = float(np.deg2rad(heading_deg))

    def state(self) -> list[float]:
        """Return where and how it flies: the numbers of `FIELDS`."""
        *state, north_deg, east_deg = [read() for read in self._read]
        return [*state, (north_deg - _LATITUDE_DEG) * _NORTH_M, east_deg * _EAST_M]

    def fly(self, controls: list[float]) -> None:
        """Fly for a step of an agent: elevator, aileron, rudder and throttle in [-1, 1]."""
        now, time_s = self.start.conditions, self._step / POLICY_HZ
        if time_s == COMMAND_S:
            self.command(self.start.altitude_ft, self.start.heading_deg)
        put, since_s = self._set, time_s - COMMAND_S
        if time_s <= ICE_S:
            put["lost_lift"](now["lost_lift"] * time_s / ICE_S)
            put["added_drag"](now["added_drag"] * time_s / ICE_S)
        if 0.0 <= since_s <= WIND_S:
            put["wind"](now["tailwind_kt"] * _FPS_PER_KT * since_s / WIND_S)
            put["down"](now["downdraught_ft_min"] / 60.0 * since_s / WIND_S)
        put["stuck"](float(0.0 <= since_s < now["stuck_s"]))
        slow_kt = self._wanted_kt - self._speed_kt()
        self._power = min(max(self._power + _INTEGRAL * slow_kt / POLICY_HZ, 0.0), 1.0)
        power = self._power + _PROPORTIONAL * slow_kt
        for name, value in zip(("elevator", "aileron", "rudder"), controls, strict=False):
            put[name](value)
        for lever in self._levers:
            lever(min(max(power + controls[3], 0.0), 1.0))
        run = self._fdm.run
        for _ in range(RATE_HZ // POLICY_HZ):
            run()
        self._step += 1


def _load(aircraft: str) -> Any:
    """Load an aircraft into a JSBSim of its own, which prints nothing."""
    jsbsim: Any = import_module("jsbsim")  # only a world needs it
    jsbsim.FGJSBBase().debug_lvl = 0
    jsbsim.set_logger(jsbsim.DefaultLogger(jsbsim.LogLevel.FATAL))
    root, model = Path(jsbsim.__file__).parent, AIRCRAFT[aircraft].model
    fdm = jsbsim.FGFDMExec(str(root))
    fdm.set_dt(1.0 / RATE_HZ)  # before the model: its filters keep the step that they were made for
    with tempfile.TemporaryDirectory() as folder:
        (made := Path(folder, model)).mkdir()
        for name, content in _files(aircraft, root):
            (made / name).write_bytes(content)
        fdm.load_model_with_paths(model, folder, str(root / "engine"), str(root / "systems"), True)
    return fdm


@cache
def _files(aircraft: str, root: Path) -> tuple[tuple[str, bytes], ...]:
    """Return the files of an aircraft by name, with what is added to them."""
    built = AIRCRAFT[aircraft]
    source = root / "aircraft" / built.model
    top = ElementTree.parse(source / f"{built.model}.xml").getroot()
    for output in top.findall("output"):
        top.remove(output)
    controls, place = top.find("flight_control"), top.find("metrics/location[@name='AERORP']")
    assert controls is not None
    assert place is not None
    for summer in controls.iter("summer"):
        words = summer.get("name", "").lower().replace("fcs/", "").replace("-", " ").split()
        if words[1:] == ["trim", "sum"] and words[0] in ("pitch", "roll"):
            for entry in summer.findall("input"):
                if (entry.text or "").strip().startswith("ap/"):
                    summer.remove(entry)
            ElementTree.SubElement(summer, "input").text = f"fcs/servo-{words[0]}"
    servos = ElementTree.fromstring(_SERVOS.format(roll=built.roll))
    top.insert([*top].index(controls), servos)
    top.append(ElementTree.fromstring(_ICE.format(place=ElementTree.tostring(place, "unicode"))))
    autopilots = ((path.name, path.read_bytes()) for path in sorted(source.glob("*ap.xml")))
    return (f"{built.model}.xml", ElementTree.tostring(top)), *autopilots
