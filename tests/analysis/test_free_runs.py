"""Cohesion and alignment of free runs, of individuals whose motion is known."""

import numpy as np
import pytest

from swarmssm.analysis.posterior.subject import subject_of
from swarmssm.analysis.scoring.forecasters import BaselineForecaster
from swarmssm.analysis.scoring.free_runs import collective_scores, free_run_starts
from swarmssm.analysis.scoring.references import ConstantVelocity, StayPut
from swarmssm.tracks import make_tracks

FPS = 10.0


def parting(num_times=21):
    """Two that part at 1 and 3 units a second from 1 apart, and a third far away at rest."""
    t = np.arange(num_times) / FPS
    zero = np.zeros_like(t)
    position = np.stack(
        [
            np.stack([-t, zero], -1),
            np.stack([1 + 3 * t, zero], -1),
            np.stack([zero, zero + 100.0], -1),
        ],
        axis=1,
    )
    velocity = np.broadcast_to([[-1.0, 0.0], [3.0, 0.0], [0.0, 0.0]], position.shape).copy()
    return position, velocity


def scored(quick_fit, position, velocity, steps):
    count = position.shape[-2]
    tracks = make_tracks(
        position,
        velocity=velocity,
        fps=FPS,
        adjacency=np.zeros((*position.shape[:-1], count), dtype=int),
    )
    subject = subject_of(quick_fit, tracks)
    forecasters = [BaselineForecaster(kind(), subject) for kind in (StayPut, ConstantVelocity)]
    return collective_scores(subject, forecasters, steps=steps, starts=1, draws=1, seed=0)


def test_curves_are_those_worked_out_by_hand(quick_fit):
    found, notes = scored(quick_fit, *parting(), steps=20)
    t = np.arange(21) / FPS
    # The two are each other's nearest at 1 + 4t; the third is 100 from the first at its start.
    far = np.minimum(np.hypot(100.0, t), np.hypot(100.0, 1 + 3 * t))
    truth = (2 * (1 + 4 * t) + far) / 3
    np.testing.assert_allclose(found["amd"].sel(series="truth"), truth)
    np.testing.assert_allclose(found["amd"].sel(series="constant-velocity"), truth)
    np.testing.assert_allclose(found["amd"].sel(series="stay-put"), (2 + 100.0) / 3)
    np.testing.assert_allclose(found["avd"], (4 + 1 + 3) / 3)
    assert float(found["amd_mean"].sel(series="truth")) == pytest.approx(truth.mean())
    error = np.abs(truth - 34.0).mean()
    assert float(found["amd_error"].sel(series="stay-put")) == pytest.approx(error)
    assert float(found["amd_error"].sel(series="constant-velocity")) == pytest.approx(0, abs=1e-9)
    assert notes == []
    assert found.attrs == {"scored_steps": 20, "num_starts": 1}
    np.testing.assert_allclose(found["time"], t)


def test_who_leaves_is_left_out_on_both_sides_and_who_joins_does_not_count(quick_fit):
    position, velocity = parting()
    for values in (position, velocity):
        values[5:, 2] = np.nan
    late = np.full((21, 1, 2), np.nan)
    late[10:] = 50.0
    position = np.concatenate([position, late], axis=1)
    velocity = np.concatenate([velocity, np.where(np.isnan(late), np.nan, 0.0)], axis=1)
    found, _ = scored(quick_fit, position, velocity, steps=20)
    t = np.arange(21) / FPS
    for series in ("truth", "constant-velocity"):
        np.testing.assert_allclose(found["amd"].sel(series=series)[5:], 1 + 4 * t[5:])
        np.testing.assert_allclose(found["avd"].sel(series=series)[5:], 4.0)
    np.testing.assert_allclose(found["amd"].sel(series="stay-put")[5:], 1.0)


def test_beyond_the_truth_runs_go_on_and_are_not_scored(quick_fit):
    position, velocity = parting(6)
    found, notes = scored(quick_fit, position, velocity, steps=20)
    t = np.arange(21) / FPS
    assert np.isnan(found["avd"].sel(series="truth")[6:]).all()
    assert np.isfinite(found["amd"].sel(series="constant-velocity")).all()
    truth = (2 * (1 + 4 * t) + np.hypot(100.0, t)) / 3
    assert float(found["amd_mean"].sel(series="constant-velocity")) == pytest.approx(
        truth[:6].mean()
    )
    assert found.attrs["scored_steps"] == 5
    assert any("over 5 steps" in note for note in notes)


def test_starts_leave_room_for_the_run_where_there_is_room(quick_fit):
    position, velocity = parting(31)
    short = np.full_like(position, np.nan)
    short[:8] = position[:8]
    tracks = make_tracks(
        np.stack([position, short]),
        velocity=np.stack([velocity, np.where(np.isnan(short), np.nan, velocity)]),
        fps=FPS,
        adjacency=np.zeros((2, 31, 3, 3), dtype=int),
    )
    trials, rows = free_run_starts(subject_of(quick_fit, tracks), 10, 3)
    assert trials.tolist() == [0, 0, 0, 1]
    assert rows.tolist() == [0, 10, 20, 0]
