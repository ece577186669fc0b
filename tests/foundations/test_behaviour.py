"""What agents do in failures: in words, counted, and compared with passes."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sada_gym import GymnasiumApplication
from sada_gym.application import Application, Scored
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.driving import DrivingApplication
from sada_gym.envs.driving.behaviour import place_on
from sada_gym.envs.robot import RobotApplication
from sada_gym.envs.uav import UAVApplication
from sada_gym.foundations.behaviour import Behaviour, Behaviours, differences, plain_values
from sada_gym.parameters import Parameter, ParameterSpace


def worlds(application: Application, count: int) -> tuple[Any, list[int]]:
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1.0, 1.0, (count, len(application.parameters))).astype(np.float32)
    return mu, list(range(100, 100 + count))


def told(application: Application, count: int) -> list[tuple[dict[str, Any], Behaviour]]:
    mu, seeds = worlds(application, count)
    infos = application.evaluate(mu, seeds).infos
    behaviours = application.behaviours(mu, seeds)
    assert behaviours[1:2] == application.behaviours(mu[1:2], seeds[1:2]), "alone as in a batch"
    return list(zip(infos, behaviours, strict=True))


def test_events_of_single_part_worlds_are_counted_by_worlds() -> None:
    failures = [Behaviour("", ("seen as bus",))] * 7 + [Behaviour("", ("not seen",))] * 3
    found = Behaviours.of(failures)
    assert found is not None
    assert found.sentence == "seen as bus in 7 of 10 worlds, not seen in 3"


def test_events_of_parts_are_counted_by_failed_parts_and_the_rest_is_summed_up() -> None:
    one = Behaviour("", ("a", "a", "b", "c", "d", "e"), "drive")
    found = Behaviours.of([one, Behaviour("", ("a",), "drive")])
    assert found is not None
    assert found.sentence == ("a in 3 of 7 failed drives, b in 1, c in 1, something else in 2")


def test_nothing_is_summed_up_where_nothing_is_told() -> None:
    assert Behaviours.of([]) is None
    assert Behaviours.of([Behaviour("Q = 0.10")]) is None


def test_differences_name_what_tells_failures_from_passes() -> None:
    failures = [Behaviour("", data={"hit": True, "v": 9 + i, "why": "wall"}) for i in range(4)]
    passes = [Behaviour("", data={"hit": False, "v": i, "why": "ok"}) for i in range(4)]
    assert differences(failures, passes) == (
        "hit in 4 of 4 failures, in 0 of 4 passes",
        "why wall in 4 of 4 failures, in 0 of 4 passes",
        "v 10.5 in failures, 1.5 in passes (medians)",
    )
    assert differences(failures, failures) == ()
    assert differences(failures[:2], passes) == (), "too few"


def test_differences_by_chance_are_rare() -> None:
    rng = np.random.default_rng(0)

    def draw() -> list[Behaviour]:
        return [
            Behaviour("", data={f"x{i}": float(v) for i, v in enumerate(rng.normal(size=20))})
            for _ in range(10)
        ]

    assert sum(bool(differences(draw(), draw())) for _ in range(200)) <= 10


def test_plain_values_leave_out_what_cannot_be_compared_or_shown() -> None:
    info = {
        "crashed": np.bool_(True),
        "speed": np.float32(2.0),
        "nan": float("nan"),
        "image": np.zeros((4, 4)),
        "story": "x" * 100,
        "why": "\x1b[31mwall",
        3: {"a": 1, "deeper": {"b": 1}},
    }
    found = plain_values(info)
    assert found == {"crashed": True, "speed": 2.0, "why": "\\x1b[31mwall", "3.a": 1}
    assert type(found["crashed"]) is bool


def test_a_detector_says_which_class_it_saw_in_the_place_of_the_object() -> None:
    pairs = told(DetectionApplication("car"), 24)
    seen = [(info, one) for info, one in pairs if one.data.get("seen_as")]
    assert seen
    for info, one in pairs:
        assert bool(one.events) == info["fooled"]
    for info, one in seen:
        label = one.data["seen_as"]
        assert one.events == (f"seen as {label}",)
        assert label != "car"
        assert one.data["confidence"] in [found["score"] for found in info["detections"]]


def test_a_detector_that_sees_another_class_elsewhere_does_not_take_the_object_for_it() -> None:
    application = DetectionApplication("car")
    info = {"fooled": True, "score": 0.1, "box": np.array([10.0, 10, 50, 50])}
    labels = {name: label for label, name in application.class_names.items()}
    far = {"label": labels["bus"], "score": 0.9, "box": [60.0, 60, 100, 100]}
    near = {"label": labels["truck"], "score": 0.4, "box": [11.0, 9, 50, 52]}
    faint = {"label": labels["boat"], "score": 0.3, "box": [10.0, 10, 50, 50]}
    behaviour = application.behaviour({**info, "detections": [far, near, faint]})
    assert behaviour.events == ("seen as truck",)
    assert application.behaviour({**info, "detections": [far, faint]}).events == ("not seen",)
    unseen = {**info, "box": np.zeros(4), "detections": [far]}
    assert application.behaviour(unseen).events == ("out of sight",)


def test_a_driver_says_where_it_failed() -> None:
    application = DrivingApplication("one_curve")
    pairs = told(application, 2)
    for info, one in pairs:
        assert [drive["ending"] for drive in one.data["drives"]] == info["endings"]
        assert len(one.events) == 5 - info["endings"].count("arrived")
    assert any("turn" in event or "bend" in event for _, one in pairs for event in one.events)


def test_places_on_a_route_are_named_by_turns() -> None:
    left, _, _, right, bend = DrivingApplication("one_curve").routes

    def names(route: Any) -> list[str]:
        return list(dict.fromkeys(place_on(route, m) for m in np.arange(0.0, route.length_m)))

    street = "on a straight street"
    turns = [f"{where} a left turn" for where in ("before", "in", "after")]
    assert names(left) == [street, *turns, street][: len(names(left))]
    assert "in a right turn" in names(right)
    assert any(name.startswith("in a bend") for name in names(bend))


def test_a_pilot_says_which_gate_it_missed_first() -> None:
    pairs = told(UAVApplication(3), 8)
    for info, one in pairs:
        assert [gate["ending"] for gate in one.data["gates"]] == info["endings"]
        missed = info["endings"].count("passed") < 8
        assert bool(one.events) == missed
        assert all(event.endswith(" first") for event in one.events)
    assert any("hit the frame of gate" in one.text for _, one in pairs)


def test_a_robot_says_what_it_touched() -> None:
    pairs = told(RobotApplication(), 4)
    for info, one in pairs:
        assert [trip["ending"] for trip in one.data["trips"]] == info["endings"]
        for trip in one.data["trips"]:
            assert ("touched" in trip) == (trip["ending"] == "collided")
    assert any(event.startswith("hit a ") for _, one in pairs for event in one.events)


def test_a_classifier_says_what_it_took_the_image_for() -> None:
    for info, one in told(DigitsApplication(), 40):
        assert (info["label"] != info["predicted"]) == any("taken for" in e for e in one.events)
        assert one.data["predicted"] == info["predicted"]


class Wall(gym.Env[Any, Any]):
    """Who is too fast hits a wall in the fourth step."""

    observation_space = gym.spaces.Box(-1, 1, (1,))
    action_space = gym.spaces.Discrete(2)
    speed = 1.0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.time = 0
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> Any:
        self.time += 1
        crashed = self.speed > 1.2 and self.time > 3
        info = {"crashed": crashed, "inner": {"speed": np.float64(self.speed)}}
        return np.zeros(1, np.float32), 1.0, crashed, False, info


def wall(**options: Any) -> GymnasiumApplication:
    return GymnasiumApplication(
        Wall,
        agent=lambda _: 0,
        parameters={"speed": (0.5, 2.0)},
        score=("length", 10),
        fooling_threshold=0.5,
        max_steps=10,
        agent_id="still",
        **options,
    )


def test_any_environment_says_when_it_ended_and_what_its_infos_tell() -> None:
    pairs = told(wall(), 12)
    failures = [one for info, one in pairs if info["fooled"]]
    passes = [one for info, one in pairs if not info["fooled"]]
    assert failures[0].text == "terminated, crashed after 4 steps, return 4"
    found = Behaviours.of(failures, passes)
    assert found is not None
    assert found.events[0].text == "terminated, crashed"
    assert any(text.startswith("info crashed in") for text in found.differences)
    assert "info inner.speed" in failures[0].data


def test_worlds_that_are_infeasible_or_too_many_for_the_memory_keep_their_places(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    application = wall(feasible="speed < 1.5", episodes=2)
    together = application.behaviours(*worlds(application, 9))
    monkeypatch.setattr("sada_gym.envs.wrapped.episodes.MEMORY_BYTES", -1)
    assert application.behaviours(*worlds(application, 9)) == together
    infos = application.evaluate(*worlds(application, 9)).infos
    for info, one in zip(infos, together, strict=True):
        assert bool(info["invalid"]) == ("feasible" in one.text)
        assert len(one.events) == (2 if info["fooled"] else 0)


class Told(Application):
    """Its info says how the world ended."""

    name = "Told"
    fooling_threshold = 0.3
    sample_size = 10
    parameters = ParameterSpace(Parameter("a", 0, 10))

    def evaluate_batch(self, mu: Any, seeds: Any) -> Scored:
        ending = {True: "fell over", False: "stood"}
        score = (mu[:, 0].astype(np.float64) + 1) / 2
        return Scored(score, [{"ending": ending[q <= 0.3], "height": float(q)} for q in score])


def test_an_application_of_ones_own_tells_its_ending() -> None:
    assert not Told().tells_behaviour, "attacks play nothing again"
    pairs = told(Told(), 20)
    failures = [one for info, one in pairs if info["fooled"]]
    passes = [one for info, one in pairs if not info["fooled"]]
    assert {one.events for one in failures} == {("fell over",)}
    assert {(one.text, one.events) for one in passes} == {("stood", ())}
    found = Behaviours.of(failures, passes)
    assert found is not None
    assert "height" in found.sentence
