import numpy as np
import pytest

from sada_gym.envs.uav.agent.pilot import PrivilegedPilot
from sada_gym.envs.uav.episodes import (
    GATE_LIMIT_S,
    POLICY_HZ,
    RaceDistribution,
    RacingEpisodes,
    RacingStart,
    benchmark_starts,
)
from sada_gym.envs.uav.world.drone import upright
from sada_gym.envs.uav.world.gates import CENTRE_HEIGHT_M, OPENING_WIDTH_M
from sada_gym.envs.uav.world.referee import GateOutcome, touches
from sada_gym.envs.uav.world.track import GATES, TEMPLATES

H = CENTRE_HEIGHT_M
ROW = np.array([[8.0 * k, 0.0, H, 0.0] for k in range(1, 5)])
"""Four gates one behind another."""
FORWARD = np.array([0.5, 0.0, 0.0, 0.0])
ONE = np.zeros(1, np.intp)


def race(place, *, gates=ROW, velocity=(8.0, 0.0, 0.0), first=0):
    return RacingEpisodes([RacingStart(gates, (*place, 0.0), velocity=velocity, first=first)])


def fly(races, action, seconds):
    for _ in range(round(seconds * POLICY_HZ)):
        which = races.under_way()
        if not len(which):
            return
        races.step(which, np.tile(action, (len(which), 1)))


def test_gates_are_passed_in_order_and_the_race_is_over():
    races = race((4, 0, H))
    fly(races, FORWARD, 1.0)
    assert races.next_gate[0] == 1
    fly(races, FORWARD, 10.0)
    assert races.endings[0].tolist() == [GateOutcome.PASSED] * 4
    assert len(races.under_way()) == 0
    assert races.score[0] == 1.0
    assert races.time_s[0] == pytest.approx((32 - 4) / 8, abs=0.15)
    np.testing.assert_allclose(races.ended_at[0, :, 0], ROW[:, 0], atol=0.1)


@pytest.mark.parametrize(
    ("place", "passed"),
    [
        ((4, 0, H), True),
        ((4, OPENING_WIDTH_M / 2 - 0.2, H), True),
        ((4, -OPENING_WIDTH_M / 2 + 0.2, H + 0.9), True),
        ((4, 2.0, H), False),
        ((4, 0, H + 2.2), False),
        ((12, 0, H), False),
    ],
)
def test_only_the_opening_counts(place, passed):
    races = race(place)
    fly(races, FORWARD, 0.8)
    assert races.endings[0, 0] == (GateOutcome.PASSED if passed else GateOutcome.AHEAD)
    assert races.next_gate[0] == int(passed)


def test_the_wrong_direction_does_not_count():
    races = race((12, 0, H), velocity=(-8.0, 0.0, 0.0))
    fly(races, -FORWARD, 1.0)
    assert races.states[0, 0] < 8
    assert races.endings[0, 0] == GateOutcome.AHEAD


def test_a_gate_out_of_order_does_not_count():
    races = race((12, 0, H))
    fly(races, FORWARD, 1.0)
    assert races.states[0, 0] > 16
    assert not races.endings.any()


def test_who_takes_ten_seconds_misses_the_gate_and_is_set_back_at_the_start():
    races = race((4, 0, H), velocity=(0.0, 0.0, 0.0))
    fly(races, np.array([-0.1, 0.0, 0.0, 0.0]), GATE_LIMIT_S - 1 / POLICY_HZ)
    assert races.endings[0, 0] == GateOutcome.AHEAD
    fly(races, np.zeros(4), 1 / POLICY_HZ)
    assert races.endings[0].tolist() == [
        GateOutcome.LATE,
        GateOutcome.AHEAD,
        GateOutcome.AHEAD,
        GateOutcome.AHEAD,
    ]
    assert races.next_gate[0] == 1
    np.testing.assert_array_equal(races.states[0], upright((4, 0, H), 0.0))
    fly(races, FORWARD, 3.0)
    assert races.endings[0, 1] == GateOutcome.PASSED


def test_who_misses_a_gate_is_set_back_at_the_last_that_it_passed():
    races = race((4, 0, H))
    fly(races, FORWARD, 0.8)
    assert races.endings[0, :2].tolist() == [GateOutcome.PASSED, GateOutcome.AHEAD]
    for missed in (1, 2):
        fly(races, np.zeros(4), GATE_LIMIT_S)
        assert races.endings[0, missed] == GateOutcome.LATE
        np.testing.assert_array_equal(races.states[0], upright((8, 0, H), 0.0))


def test_the_ten_seconds_begin_at_each_gate():
    races = race((4, 0, H))
    fly(races, FORWARD, 0.8)
    assert races.next_gate[0] == 1
    fly(races, np.zeros(4), GATE_LIMIT_S - 0.6)
    assert races.next_gate[0] == 1
    fly(races, np.zeros(4), 0.6)
    assert races.endings[0, :2].tolist() == [GateOutcome.PASSED, GateOutcome.LATE]


def test_who_always_waits_misses_all_and_the_race_ends():
    races = race((4, 0, H))
    fly(races, np.zeros(4), 60.0)
    assert races.endings[0].tolist() == [GateOutcome.LATE] * 4
    assert races.score[0] == 0.0
    assert races.time_s[0] == pytest.approx(4 * GATE_LIMIT_S)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_pilot_that_diverges_misses_gates_and_nothing_breaks(bad):
    races = race((4, 0, H))
    actions = FORWARD.copy()
    actions[1] = bad
    fly(races, actions, 5.0)
    assert races.endings[0].tolist() == [GateOutcome.LOST] * 4
    assert races.steps[0] == 4
    assert np.isfinite(races.states).all()


def test_who_leaves_the_world_is_lost():
    races = race((4, 0, H))
    fly(races, np.array([0.0, 0.0, 1.0, 0.0]), 5.0)
    assert races.endings[0, 0] == GateOutcome.LOST
    assert len(races.under_way()) == 1


@pytest.mark.parametrize(
    ("place", "action"),
    [
        ((4, 1.3, H), [0.5, 0, 0, 0]),  # a post
        ((4, -1.15, H), [0.5, 0, 0, 0]),  # the middle is in the opening, a rotor is not
        ((4, 0, H + 1.3), [0.5, 0, 0, 0]),  # the upper bar
        ((4, 0, H - 1.3), [0.5, 0, 0, 0]),  # the lower bar
        ((4, 0, 0.5), [0, 0, -0.5, 0]),  # the ground
        ((12, 1.3, H), [0.5, 0, 0, 0]),  # the frame of another gate
        ((12, 1.3, H), [-0.5, 0, 0, 0]),  # a frame from behind
    ],
)
def test_who_touches_something_misses_the_gate_and_is_set_back_at_once(place, action):
    velocity = (16.0 * action[0], 0.0, 16.0 * action[2])
    races = race(place, velocity=velocity)
    while races.next_gate[0] == 0:
        assert races.time_s[0] < 1
        fly(races, np.array(action), 1 / POLICY_HZ)
    assert races.endings[0].tolist() == [
        GateOutcome.HIT,
        GateOutcome.AHEAD,
        GateOutcome.AHEAD,
        GateOutcome.AHEAD,
    ]
    np.testing.assert_array_equal(races.states[0], upright(place, 0.0))
    assert touches(upright(races.ended_at[0, 0], 0.0), ROW) or place[1] == -1.15
    assert np.isnan(races.ended_at[0, 1:]).all()
    time_s = races.time_s[0]
    np.testing.assert_allclose(
        races.ended_at[0, 0], np.array(place) + time_s * np.array(velocity), atol=0.15
    )


def test_who_hits_the_second_gate_is_set_back_into_the_first():
    gates = ROW.copy()
    gates[1, 1] = 1.3
    races = race((4, 0, H), gates=gates)
    fly(races, FORWARD, 1.5)
    assert races.endings[0, :3].tolist() == [GateOutcome.PASSED, GateOutcome.HIT, GateOutcome.AHEAD]
    assert races.ended_at[0, 1, 0] == pytest.approx(16 - 0.27, abs=0.05)


def test_nobody_flies_through_a_bar_however_fast():
    rng = np.random.default_rng(0)
    for _ in range(20):
        races = race((rng.uniform(6, 7), 1.3, H), velocity=(16.0, 0.0, 0.0))
        fly(races, np.array([1.0, 0, 0, 0]), 0.3)
        assert races.endings[0, 0] == GateOutcome.HIT
        assert races.ended_at[0, 0, 0] < 8


def test_a_gate_that_was_passed_stays_so_where_its_frame_is_hit_afterwards():
    races = race((7.9, 0, H), velocity=(2.0, 10.0, 0.0))
    while races.next_gate[0] < 2:
        fly(races, np.array([0.0, 0.9, 0.0, 0.0]), 1 / POLICY_HZ)
    assert races.endings[0, :2].tolist() == [GateOutcome.PASSED, GateOutcome.HIT]
    assert abs(races.ended_at[0, 1, 0] - 8) < 0.3
    np.testing.assert_array_equal(races.states[0], upright((8, 0, H), 0.0))


def test_on_its_back_above_the_ground_a_drone_flies_on_and_on_the_ground_it_has_hit():
    for height, ending in ((3.0, GateOutcome.AHEAD), (0.1, GateOutcome.HIT)):
        races = race((4, 0, H))
        state = upright((4, 0, height), 0.0)
        state[3:7] = [1.0, 0.0, 0.0, 0.0]
        races.place(0, state)
        fly(races, np.zeros(4), 0.1)
        assert races.endings[0, 0] == ending


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_drone_that_is_lost_takes_no_old_command_with_it(value):
    races = race((4, 0, H), velocity=(0.0, 0.0, 0.0))
    races.step(ONE, np.array([[1.0, 0, 0, 0]]))
    state = races.states[0].copy()
    state[8] = value
    races.place(0, state)
    races.step(ONE, np.array([[1.0, 0, 0, 0]]))
    assert races.endings[0, 0] == GateOutcome.LOST
    np.testing.assert_allclose(races.states[0], upright((4, 0, H), 0.0), atol=1e-12)


def test_numbers_that_are_none_lose_a_drone():
    races = race((4, 0, H))
    state = upright((4, 0, H), 0.0)
    state[7] = np.nan
    races.place(0, state)
    races.step(ONE, FORWARD[None])
    assert races.endings[0, 0] == GateOutcome.LOST
    fly(races, FORWARD, 10.0)
    assert races.endings[0, 1:].tolist() == [GateOutcome.PASSED] * 3


def test_a_drone_that_is_lost_leaves_the_others_alone():
    made = starts(2)
    alone = outcome(made[:1])
    races = RacingEpisodes(made)
    while len(which := races.under_way()):
        if races.steps[0] % 7 == 3:
            races.place(1, np.full(13, np.nan))
        if races.steps[0] % 7 == 5:
            races.place(1, np.full(13, 1e200))
        races.step(which, Clumsy().act(races, which))
    np.testing.assert_array_equal(races.endings[0], alone.endings[0])
    np.testing.assert_array_equal(races.states[0], alone.states[0])
    assert (races.endings[1] == GateOutcome.LOST).sum() > 5


def test_after_a_miss_the_race_goes_on_to_the_gate_after():
    tracks = TEMPLATES[3].tracks(np.zeros((1, 6)))
    races = RacingEpisodes(benchmark_starts(tracks, [0]))
    pilot = PrivilegedPilot(8.0)
    while len(which := races.under_way()):
        asleep = races.next_gate[0] == 4
        races.step(which, np.zeros((1, 4)) if asleep else pilot.act(races, which))
    assert races.endings[0, :5].tolist() == [GateOutcome.PASSED] * 4 + [GateOutcome.LATE]
    assert races.endings[0, 5] == GateOutcome.HIT  # the frame of the gate that it slept before
    assert races.endings[0, 6:].tolist() == [GateOutcome.PASSED] * 2


class Clumsy:
    """A pilot in a hurry, which hits frames."""

    def act(self, races, which):
        return PrivilegedPilot(14.0).act(races, which)


def outcome(starts):
    races = RacingEpisodes(starts)
    while len(which := races.under_way()):
        races.step(which, Clumsy().act(races, which))
    return races


def starts(count):
    rng = np.random.default_rng(4)
    made = []
    for i in range(count):
        anchors = (3, 4, 5)[i % 3]
        mu = rng.uniform(-1, 1, (1, 2 * anchors))
        tracks = TEMPLATES[anchors].tracks(mu)
        made += benchmark_starts(tracks, [int(rng.integers(2**31))])
    return made


def test_a_race_does_not_depend_on_who_else_races():
    made = starts(17)
    together = outcome(made)
    assert {GateOutcome.PASSED, GateOutcome.HIT} <= {*together.endings.flat}
    order = np.random.default_rng(0).permutation(17)
    batches = [order, order[:16], [16, 3, 16, 3, 3], *([i] for i in range(12, 17))]
    for rows in batches:
        again = outcome([made[i] for i in rows])
        for name in ("endings", "ended_at", "time_s", "states", "steps"):
            np.testing.assert_array_equal(
                getattr(again, name), getattr(together, name)[list(rows)], err_msg=name
            )


def test_races_do_not_disturb_one_another_in_turn():
    made = starts(6)
    both, begun = [RacingEpisodes(made[:4]), RacingEpisodes(made[4:])], outcome(made)
    while any(len(races.under_way()) for races in both):
        for races in both:
            if len(which := races.under_way()):
                races.step(which, Clumsy().act(races, which))
    states = np.concatenate([races.states for races in both])
    np.testing.assert_array_equal(states, begun.states)


def test_a_race_begun_anew_is_as_in_a_new_world():
    made = starts(3)
    fresh = outcome([made[2]])
    races = RacingEpisodes([made[0], made[1]])
    for _ in range(70):
        races.step(np.arange(2), Clumsy().act(races, np.arange(2)))
    races.begin(1, made[2])
    while races.next_gate[1] < GATES:
        races.step(ONE + 1, Clumsy().act(races, ONE + 1))
    np.testing.assert_array_equal(races.endings[1], fresh.endings[0])
    np.testing.assert_array_equal(races.states[1], fresh.states[0])
    assert races.time_s[1] == fresh.time_s[0]


def test_gates_before_the_first_count_as_passed():
    races = race((20, 0, H), first=2)
    assert races.endings[0].tolist() == [1, 1, 0, 0]
    fly(races, FORWARD, 5.0)
    assert races.score[0] == 1.0


def test_seeds_move_the_start_a_little_and_fix_the_look():
    tracks = TEMPLATES[4].tracks(np.zeros((50, 8)))
    made = benchmark_starts(tracks, range(50))
    off = np.array([start.place for start in made]) - tracks.starts
    assert np.abs(off[:, :2]).max() <= 0.3
    assert np.abs(off[:, 2]).max() == 0
    assert np.abs(np.rad2deg(off[:, 3])).max() <= 5
    assert np.unique(off[:, 0]).size == 50
    assert [start.seed for start in made] == list(range(50))
    np.testing.assert_array_equal(made[7].place, benchmark_starts(tracks, range(50))[7].place)


def test_a_course_begins_before_any_gate():
    rng = np.random.default_rng(0)
    made = [RaceDistribution().draw(rng) for _ in range(60)]
    for start in made:
        first = start.gates[0]
        away = first[:2] - start.place[:2]
        ahead = away[0] * np.cos(first[3]) + away[1] * np.sin(first[3])
        assert 1.5 < ahead < 7.0
        assert np.hypot(*start.velocity[:2]) <= 10.0


def test_what_pilots_are_told_is_in_their_level_frame():
    state = upright((4, 0, H), np.pi / 2)
    state[7:10] = [8.0, 0.0, 1.6]
    races = race((0, 0, H))
    races.place(0, state)
    seen = races.observe(ONE)
    np.testing.assert_allclose(seen["gates"][0, :5], [0, -0.2, 0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(seen["gates"][0, 5:], [0, -0.6, 0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(seen["motion"][0], [0, -0.5, 0.1, 0, 0, 1, 0, 0, 0], atol=1e-6)
    assert seen["gates"].dtype == seen["motion"].dtype == np.float32
