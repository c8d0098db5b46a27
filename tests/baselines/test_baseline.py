"""Baselines against motions whose future is known in the head."""

from typing import ClassVar

import numpy as np
import pytest

from swarmssm import metrics
from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.analysis.scoring.references import REFERENCES, ConstantVelocity, StayPut
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

FPS = 10.0


class Straight(Baseline):
    """Goes on from two positions as a ruler would; velocity likewise."""

    name: ClassVar[str] = "straight"
    title: ClassVar[str] = "straight"
    order: ClassVar[int] = 2

    def step(self, window, fps):
        return 2 * window[..., -1, :, :] - window[..., -2, :, :]


def line(num_times=8):
    """Two individuals on straight lines: (1 + t, 2) at 10 per second and (5, 3 - 2t)."""
    t = np.arange(num_times)[:, None]
    one = np.concatenate([1.0 + t, 2.0 + 0 * t], axis=1)
    two = np.concatenate([5.0 + 0 * t, 3.0 - 2.0 * t], axis=1)
    position = np.stack([one, two], axis=1)
    velocity = np.broadcast_to([[10.0, 0.0], [0.0, -20.0]], position.shape)
    return make_tracks(position, velocity=velocity, fps=FPS, individuals=["a", "b"], unit="cm")


def line_states(num_times=8):
    tracks = line(num_times)
    order = ("time", "individual", "space")
    return np.concatenate(
        [tracks[name].transpose(*order).to_numpy() for name in ("position", "velocity")], axis=-1
    )


def test_each_is_registered_under_its_name():
    assert {name: kind.name for name, kind in REFERENCES.items()} == {
        "stay-put": "stay-put",
        "constant-velocity": "constant-velocity",
    }


def test_stay_put_repeats_the_last_state():
    path = StayPut().predict(line_states(4), 3, FPS)
    assert path.shape == (3, 2, 4)
    np.testing.assert_array_equal(path, np.broadcast_to(line_states(4)[-1], (3, 2, 4)))


def test_constant_velocity_goes_on_straight():
    path = ConstantVelocity().predict(line_states(4), 4, FPS)
    np.testing.assert_allclose(path, line_states(8)[4:], rtol=0, atol=1e-12)


def test_one_step_predicts_each_frame_from_the_one_before():
    states = line_states()
    predicted = ConstantVelocity().one_step(states, FPS)
    assert np.isnan(predicted[0]).all()
    np.testing.assert_allclose(predicted[1:], states[1:], rtol=0, atol=1e-12)
    assert metrics.mae(states, StayPut().one_step(states, FPS)) == pytest.approx(1.0)


def test_leading_axes_are_kept():
    states = np.stack([line_states(), line_states() + 1.0])[None]
    assert StayPut().one_step(states, FPS).shape == states.shape
    assert StayPut().predict(states, 5, FPS).shape == (1, 2, 5, 2, 4)


def test_a_baseline_of_two_frames_sees_both_of_them():
    states = line_states() ** 2
    predicted = Straight().one_step(states, FPS)
    assert np.isnan(predicted[:2]).all()
    np.testing.assert_allclose(predicted[2:], 2 * states[1:-1] - states[:-2])
    path = Straight().predict(states[:2], 2, FPS)
    first = 2 * states[1] - states[0]
    np.testing.assert_allclose(path, [first, 2 * first - states[1]])


def test_who_is_unknown_is_not_forecast():
    states = line_states()
    states[3, 1, 0] = np.nan
    predicted = ConstantVelocity().one_step(states, FPS)
    assert np.isnan(predicted[4, 1, 0])
    assert np.isfinite(predicted[4, 0]).all()


@pytest.mark.parametrize("kind", REFERENCES.values())
def test_a_forecast_has_the_labels_of_the_history(kind):
    forecast = kind().forecast(line(), 3)
    assert forecast["position"].dims == ("trial", "time", "space", "individual")
    assert forecast["individual"].values.tolist() == ["a", "b"]
    assert forecast["space"].values.tolist() == ["x", "y"]
    np.testing.assert_allclose(forecast["time"], [0.8, 0.9, 1.0])
    assert forecast.attrs["horizon"] == 3
    assert forecast.attrs["unit"] == "cm"
    assert forecast["history_end"].item() == pytest.approx(0.7)


def test_a_forecast_by_constant_velocity_is_right_on_a_line():
    forecast = ConstantVelocity().forecast(line(), 2).isel(trial=0)
    np.testing.assert_allclose(forecast["position"].sel(individual="a", space="x"), [9.0, 10.0])
    np.testing.assert_allclose(forecast["position"].sel(individual="b", space="y"), [-13.0, -15.0])
    np.testing.assert_allclose(forecast["velocity"].sel(individual="b", space="y"), -20.0)


def test_each_trial_goes_on_from_its_own_last_frame_with_anybody_in_it():
    position = np.full((2, 6, 2, 2), np.nan)
    position[0] = line(6)["position"].transpose("time", "individual", "space")
    position[1, :4, 0] = position[0, :4, 0]
    forecast = ConstantVelocity().forecast(make_tracks(position, fps=FPS), 1)
    np.testing.assert_allclose(forecast["position"].sel(space="x")[0, 0], [7.0, 5.0])
    assert forecast["position"].sel(space="x")[1, 0, 0].item() == pytest.approx(5.0)
    assert np.isnan(forecast["position"][1, 0, :, 1]).all()
    np.testing.assert_allclose(forecast["history_end"], [0.5, 0.3])
    np.testing.assert_allclose(forecast["time"], [0.1])


def test_the_future_of_the_history_is_not_looked_at():
    whole = line(20)
    history = whole.isel(time=slice(0, 5))
    changed = whole.copy(deep=True)
    changed["position"][5:] += 100.0
    for tracks in (whole, changed):
        forecast = ConstantVelocity().forecast(tracks.isel(time=slice(0, 5)), 3)
        expected = ConstantVelocity().forecast(history, 3)
        np.testing.assert_array_equal(forecast["position"], expected["position"])


def random_walk(num_times=2000, seed=0):
    """Positions and velocities that walk at random, with known covariance of the steps."""
    generator = np.random.default_rng(seed)
    root = np.array([[0.3, 0, 0, 0], [0.1, 0.2, 0, 0], [0, 0.2, 0.5, 0], [0.1, 0, 0, 0.4]])
    steps = generator.standard_normal((num_times, 3, 4)) @ root.T
    states = np.cumsum(steps, axis=0)
    tracks = make_tracks(states[..., :2], velocity=states[..., 2:], fps=FPS)
    return tracks, root @ root.T


def test_fit_measures_the_covariance_of_the_errors():
    tracks, truth = random_walk()
    found = StayPut().fit(tracks).residual_covariance
    count = 3 * 1999
    # Var of a sample covariance of Gaussians: (s_ii s_jj + s_ij^2) / n.
    sd = np.sqrt((np.outer(np.diag(truth), np.diag(truth)) + truth**2) / count)
    assert (np.abs(found - truth) < 6 * sd).all()


def test_draws_spread_as_the_errors_do():
    tracks, _ = random_walk()
    baseline = StayPut().fit(tracks)
    draws = baseline.forecast(tracks, 5, draws=4000, seed=1)
    assert draws["position"].dims[0] == "draw"
    states = np.concatenate([draws["position"], draws["velocity"]], axis=-2)[:, 0, 4, :, 0]
    truth = 5 * baseline.residual_covariance
    sd = np.sqrt((np.outer(np.diag(truth), np.diag(truth)) + truth**2) / 4000)
    assert (np.abs(np.cov(states, rowvar=False) - truth) < 6 * sd).all()
    expected = baseline.forecast(tracks, 5)["position"][0, 4, :, 0]
    assert (np.abs(states[:, :2].mean(0) - expected) < 6 * np.sqrt(np.diag(truth)[:2] / 4000)).all()


def test_draws_follow_the_seed():
    tracks, _ = random_walk(50)
    baseline = ConstantVelocity().fit(tracks)
    first, again, other = (baseline.forecast(tracks, 4, draws=2, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(first["position"], again["position"])
    assert not np.array_equal(first["position"], other["position"])


def test_errors_that_are_always_zero_give_draws_that_are_the_expected_one():
    baseline = ConstantVelocity().fit(line())
    draws = baseline.forecast(line(), 3, draws=2)
    expected = np.broadcast_to(baseline.forecast(line(), 3)["position"], draws["position"].shape)
    np.testing.assert_allclose(draws["position"], expected, atol=1e-6)


def test_frames_before_the_first_are_unknown():
    assert np.isnan(Straight().predict(line_states()[:1], 1, FPS)).all()
    soon_gone = line(3)
    soon_gone["position"][1:] = np.nan
    assert np.isnan(Straight().forecast(soon_gone, 1)["position"]).all()
    predicted = Straight().one_step(line_states(), FPS)
    assert np.isnan(predicted[:2]).all()
    np.testing.assert_allclose(predicted[2:], line_states()[2:], atol=1e-12)


def test_mistakes_are_told():
    with pytest.raises(InputError, match="horizon: it must be at least 1, and it is 0"):
        StayPut().forecast(line(), 0)
    with pytest.raises(InputError, match="draws: it must be at least 0"):
        StayPut().forecast(line(), 1, draws=-1)
    with pytest.raises(InputError, match="stay-put: fit it first"):
        StayPut().forecast(line(), 1, draws=1)
    soon_gone = line(3)
    soon_gone["position"][1:] = np.nan
    with pytest.raises(InputError, match="not two steps"):
        StayPut().fit(soon_gone)
    position = np.full((4, 1, 2), np.nan)
    position[::2] = 1.0
    with pytest.raises(InputError, match="nobody is seen in two consecutive frames"):
        StayPut().forecast(make_tracks(position, fps=FPS), 1)
    with pytest.raises(TypeError, match="must define step"):
        Baseline().predict(line_states(), 1, FPS)
