from dataclasses import replace

import numpy as np
import pytest

from sada_gym.envs.uav.agent.pilot import PrivilegedPilot
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.episodes import REPLAY_HZ
from sada_gym.envs.uav.frame import (
    VIEW_COLUMNS,
    VIEW_ROWS,
    TrackMap,
    flown_ways,
    shown_step,
    summary,
)
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import GATES, line

GREEN, RED = (0, 158, 115), (213, 94, 0)
BLIND = (3, 6)
MISSED = (3, 4, 6)
"""Where it is blind, and where it hits the frame of the gate that it missed."""
MU = np.zeros(8)


class Blinking(PrivilegedPilot):
    """Sees some gates only from near by."""

    def act(self, races, which):
        actions = super().act(races, which)
        near = np.hypot(*races.waypoints(which)[:, :2].T) < 3
        actions[near & np.isin(races.next_gate[which], BLIND)] = np.nan
        return actions


def painted(picture, colour):
    plan = np.asarray(picture)[:VIEW_ROWS, VIEW_COLUMNS:].astype(int)
    return (np.abs(plan - colour).max(axis=-1) < 12).sum()


@pytest.fixture(scope="module")
def flown():
    """A race that passes all gates."""
    return UAVApplication(4, agent=PrivilegedPilot(8.0)).rollouts(MU, 5)[0]


@pytest.fixture(scope="module")
def application():
    return UAVApplication(4, agent=Blinking(8.0))


@pytest.fixture(scope="module")
def failed(application):
    return application.rollouts(MU, 5)[0]


@pytest.fixture(scope="module")
def replay(application):
    return application.replay(MU, 5)


def test_a_rollout_scores_as_the_evaluation_does(application, failed):
    outcome = application.evaluate(MU[None], [5])
    assert failed.score == outcome.score[0] == 1 - len(MISSED) / GATES
    assert failed["time_s"][-1] == outcome.infos[0]["time_s"]


def test_a_flown_race_is_green(flown):
    assert flown.score == 1
    assert painted(summary([flown]), GREEN) > 50 * GATES
    assert painted(summary([flown]), RED) == 0


@pytest.mark.long
def test_a_replay_shows_every_decision(failed, replay):
    frames, score = replay
    assert score == failed.score
    assert len(frames) == -(-(len(failed["states"]) - 1) // 2) + REPLAY_HZ  # the end stays a second
    assert UAVApplication.render_fps == REPLAY_HZ
    assert painted(frames[0], GREEN) == painted(frames[0], RED) == 0
    assert painted(frames[-1], GREEN) > 50 * (GATES - len(MISSED))
    assert painted(frames[-1], RED) > 50


def test_frames_have_one_even_shape(flown, failed, replay):
    shapes = {frame.shape for frame in [*replay[0], summary([flown]), summary([failed])]}
    (shape,) = shapes
    assert shape[0] % 2 == shape[1] % 2 == 0  # video encoders want that


def test_the_summary_looks_before_the_first_gate_missed(application, failed):
    step, text = shown_step(failed)
    assert text == f"seen: on the way to gate {BLIND[0] + 1} (lost)"
    assert failed["endings"][step, BLIND[0]] == GateOutcome.AHEAD
    assert failed["endings"][step, BLIND[0] - 1] == GateOutcome.PASSED
    assert painted(summary([failed]), RED) > 50
    np.testing.assert_array_equal(application.render(MU, 5), summary([failed]))


def test_the_summary_shows_the_gate_although_the_drone_has_flown_past_it(failed):
    step, _ = shown_step(failed)
    x, y, _, heading = failed.start.gates[BLIND[0]]
    since = np.flatnonzero(failed["endings"][:, BLIND[0] - 1] == GateOutcome.PASSED)[0]
    beyond = failed["states"][[step]].copy()
    beyond[0, :2] = x + 2 * np.cos(heading), y + 2 * np.sin(heading)
    late = step + 40
    states = np.concatenate([failed["states"][: step + 1], np.repeat(beyond, 40, axis=0)])
    endings = np.concatenate(
        [failed["endings"][: step + 1], np.repeat(failed["endings"][[step]], 40, 0)]
    )
    endings[late, BLIND[0]] = GateOutcome.LATE
    snapshots = {"states": states, "endings": endings, "time_s": np.arange(late + 1.0)}
    rollout = replace(failed, snapshots=snapshots)
    shown, _ = shown_step(rollout)
    assert since <= shown <= step


def test_two_gates_may_end_between_two_decisions(failed):
    endings = np.zeros((3, GATES), np.int8)
    endings[2, :2] = GateOutcome.PASSED, GateOutcome.LOST
    snapshots = {key: value[:3] for key, value in failed.snapshots.items()}
    rollout = replace(failed, snapshots={**snapshots, "endings": endings})
    assert shown_step(rollout) == (1, "seen: on the way to gate 2 (lost)")


def test_the_way_is_cut_where_the_drone_was_set_back(failed):
    ways = flown_ways(failed, len(failed["states"]))
    assert len(ways) == 1 + len(MISSED)
    assert sum(len(way) for way in ways) == len(failed["states"]) + len(MISSED)
    for way, gate in zip(ways, MISSED, strict=False):
        np.testing.assert_array_equal(way[-1], failed["ended_at"][-1, gate, :2])
    for way in ways:
        assert np.hypot(*np.diff(way, axis=0).T).max() < 1


def test_a_plan_holds_its_gates(flown):
    plan = TrackMap(flown.start.gates, line(flown.start.anchors))
    for x, y in plan._pixels(flown.start.gates[:, :2]):
        assert 0 < x < 2 * VIEW_ROWS
        assert 0 < y < 2 * VIEW_ROWS
    assert plan.picture().size == (VIEW_ROWS, VIEW_ROWS)
