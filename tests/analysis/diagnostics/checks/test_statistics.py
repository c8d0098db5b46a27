"""The ready-made statistics of swarms whose answers are known, in the plane and in space."""

import numpy as np
import pytest

from swarmssm.analysis.diagnostics.checks import STATISTICS, BinScales, ObservedSwarm
from swarmssm.analysis.diagnostics.checks import swarm as swarms
from swarmssm.metrics.arena import Arena

NAN = np.nan


def seen(position, fps=10.0):
    """Return positions ``(run, time, individual, space)`` as a swarm is given to statistics."""
    position = np.asarray(position, dtype=float)
    space = position.shape[-1]
    walls = Arena.box([-20.0] * space, [20.0] * space)
    velocity = np.diff(position, axis=1) * fps
    plain = ObservedSwarm(position[:, 1:], velocity, fps, "cm", walls)
    return ObservedSwarm(plain.position, velocity, fps, "cm", walls, BinScales.of(plain))


def wandering(space=2, individuals=5, frames=40, runs=2):
    steps = np.random.default_rng(0).normal(size=(runs, frames, individuals, space))
    return seen(0.1 * steps.cumsum(1) + 3 * steps[:, :1])


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("name", STATISTICS)
def test_all_have_values_that_go_with_their_axes(name, space):
    swarm = wandering(space)
    statistic = STATISTICS[name]
    value = statistic.of(swarm)
    assert np.isfinite(value).all()
    axes = () if statistic.axes is None else statistic.axes(swarm)
    assert value.shape == tuple(len(axis.values) for axis in axes)
    assert (value.ndim == 0) == (statistic.kind == "number")
    if statistic.kind == "histogram":
        assert value.sum() == pytest.approx(1.0)
        assert (value >= 0).all()


@pytest.mark.parametrize("name", STATISTICS)
def test_where_nobody_is_seen_there_is_no_value(name):
    swarm = seen(np.full((1, 10, 4, 2), NAN))
    assert np.isnan(STATISTICS[name].of(swarm)).all()


def test_what_a_lonely_animal_lacks():
    swarm = wandering(individuals=1)
    lacking = {name for name, one in STATISTICS.items() if one.missing(swarm)}
    assert STATISTICS.keys() - lacking == {
        "speed",
        "turning_angle",
        "wall_distance",
        "wall_angle",
        "velocity_autocorrelation",
        "heading_autocorrelation",
        "displacement",
    }


def test_two_that_go_straight_beside_each_other():
    """Both go along x at 20 cm/s, 3 cm apart across."""
    time = np.arange(21.0)
    position = np.zeros((1, 21, 2, 2))
    position[0, :, :, 0] = 2.0 * time[:, None]
    position[0, :, 1, 1] = 3.0
    swarm = seen(position)
    value = {name: one.of(swarm) for name, one in STATISTICS.items() if not one.missing(swarm)}
    assert value["polarization"] == pytest.approx(1.0)
    assert value["rotation"] == pytest.approx(0.0)
    assert value["amd"] == pytest.approx(3.0)
    assert value["displacement_difference"] == pytest.approx(0.0)
    # The run of 20 frames lasts 2 s.
    assert value["state_duration"] == pytest.approx(2.0)
    np.testing.assert_allclose(value["states"], [0, 1, 0, 0])
    np.testing.assert_allclose(value["velocity_autocorrelation"], 1.0)
    lags = STATISTICS["displacement"].axes(swarm)[0].values
    np.testing.assert_allclose(value["displacement"], (20 * lags) ** 2)
    # Each has the other at a right angle.
    assert STATISTICS["viewing_angle"].axes(swarm)[0].values[
        value["viewing_angle"].argmax()
    ] == pytest.approx(np.pi / 2, abs=np.pi / 18)
    # 99 % of speeds are at most 20, and bins go up to 25.
    bins = STATISTICS["speed"].axes(swarm)[0].values
    assert bins[value["speed"].argmax()] == pytest.approx(20, abs=25 / 30)


def test_what_is_beyond_the_bins_is_in_the_last():
    slow = wandering()
    fast = ObservedSwarm(
        slow.position, 100 * slow.velocity, slow.fps, "cm", slow.walls, slow.scales
    )
    assert STATISTICS["speed"].of(fast)[-1] > 0.9


def test_a_crowd_is_looked_at_in_some_frames(monkeypatch):
    swarm = wandering()
    monkeypatch.setattr(swarms, "MAX_PAIRS", 2 * 39 * 25 // 4)
    few = ObservedSwarm(swarm.position, swarm.velocity, swarm.fps, "", None, swarm.scales).sparse
    np.testing.assert_array_equal(few.position, swarm.position[:, ::5])
    assert few.fps == 2.0
