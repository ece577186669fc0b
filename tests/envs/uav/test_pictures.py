import numpy as np
import pytest

from sada_gym.agents.pilot.network import new_network
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.pictures import VIEW_COLUMNS, VIEW_ROWS, Film, Plan
from sada_gym.envs.uav.races import Ending
from sada_gym.envs.uav.reference import Reference

GREEN, RED = (22, 163, 74), (220, 38, 38)


def painted(picture, colour):
    return (np.abs(np.asarray(picture).astype(int) - colour).max(axis=-1) < 12).sum()


@pytest.fixture(scope="module")
def application():
    return UAVApplication(4, agent=new_network(0))


@pytest.fixture(scope="module")
def flown(application):
    """A race that passes all gates."""
    seeing, application._pilot = application._pilot, _Told()
    film = Film.of(application, np.zeros(8), 5)
    application._pilot = seeing
    return film


class _Told(Reference):
    def start(self, count):
        pass


@pytest.fixture(scope="module")
def failed(application):
    """A race of an untrained pilot."""
    return Film.of(application, np.zeros(8), 5)


def test_a_film_scores_as_the_evaluation_does(application, failed):
    outcome = application.evaluate(np.zeros((1, 8)), [5])
    assert failed.score == outcome.score[0]
    assert failed.times_s[-1] == outcome.infos[0]["time_s"]


def test_a_flown_race_is_green_at_its_end(flown):
    assert flown.score == 1
    frames = flown.frames()
    assert len(frames) == len(flown.states) + 19
    first, last = (frame[:VIEW_ROWS, VIEW_COLUMNS:] for frame in (frames[0], frames[-1]))
    assert painted(first, GREEN) == painted(first, RED) == 0
    assert painted(last, GREEN) > 500
    assert painted(last, RED) == 0


def test_a_failed_race_shows_what_was_missed(failed):
    assert failed.score < 1
    assert painted(failed.summary()[:VIEW_ROWS, VIEW_COLUMNS:], RED) > 100


def test_frames_have_one_even_shape(flown, failed):
    shapes = {frame.shape for film in (flown, failed) for frame in film.frames()[:3]}
    shapes |= {film.summary().shape for film in (flown, failed)}
    (shape,) = shapes
    assert shape[0] % 2 == shape[1] % 2 == 0  # video encoders want that


def test_the_summary_looks_before_the_first_gate_missed(failed):
    step, said = failed._moment()
    gate = int((failed.endings[-1] > Ending.PASSED).argmax())
    assert said == f"seen: before gate {gate + 1}"
    assert failed.endings[step, gate] == Ending.AHEAD
    if gate:
        assert failed.endings[step, gate - 1] != Ending.AHEAD


def test_a_plan_holds_its_gates(flown):
    plan = Plan(flown.start.gates, flown.line)
    for x, y in plan._pixels(flown.start.gates[:, :2]):
        assert 0 < x < 2 * VIEW_ROWS
        assert 0 < y < 2 * VIEW_ROWS
    assert plan.picture().size == (VIEW_ROWS, VIEW_ROWS)


def test_render_and_replay(application, failed):
    np.testing.assert_array_equal(application.render(np.zeros(8), 5), failed.summary())
    frames, score = application.replay(np.zeros(8), 5)
    assert score == failed.score
    np.testing.assert_array_equal(frames[-1], failed.frames()[-1])
