"""The Kalman filter and its several modes, against filterpy and against known noise."""

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.interacting import InteractingModels, turning_motion
from swarmssm.baselines.jump_filter import JumpModel
from swarmssm.baselines.kalman import (
    KalmanVelocity,
    OneModeModel,
    random_walk_noise,
    straight_motion,
)
from swarmssm.errors import InputError

FPS = 5.0
CRUISING, SWERVING, TRACKING, RATE = 0.1, 0.8, 0.05, 0.3


class Quick(InteractingModels):
    """With fewer evaluations of the likelihood."""

    evaluations = 25


def walk(num_times=40, num_individuals=3, process=0.3, tracking=TRACKING, seed=0):
    """Velocities that walk at random, positions seen with an error, velocities by difference."""
    random = np.random.default_rng(seed)
    change = process * random.standard_normal((num_times, num_individuals, 2))
    velocity = 1.0 + np.cumsum(change, axis=0)
    position = np.cumsum(velocity / FPS, axis=0)
    seen = position + tracking * random.standard_normal(position.shape)
    difference = np.full_like(seen, np.nan)
    difference[1:] = np.diff(seen, axis=0) * FPS
    return np.concatenate([seen, difference], axis=-1)


def modes(number):
    """Return a model of one mode, or of the four of the plane."""
    straight, cruising = straight_motion(2, FPS), random_walk_noise(CRUISING, 2, FPS)
    transitions = [straight, straight, turning_motion(RATE, FPS), turning_motion(-RATE, FPS)]
    noises = [cruising, random_walk_noise(SWERVING, 2, FPS), cruising, cruising]
    switching = np.full((number, number), 0.1 / max(number - 1, 1))
    np.fill_diagonal(switching, 0.9 if number > 1 else 1.0)
    kind = OneModeModel if number == 1 else JumpModel
    return kind(
        np.stack(transitions[:number]), np.stack(noises[:number]), switching, TRACKING**2, FPS
    )


def judge(model, mode, start):
    """Return filterpy's filter of one mode, begun at a state."""
    judged = KalmanFilter(dim_x=4, dim_z=2)
    judged.x, judged.F, judged.Q = start.copy(), model.transitions[mode], model.noises[mode]
    judged.H, judged.R = np.eye(2, 4), TRACKING**2 * np.eye(2)
    # A tracked position, and the difference of two of them.
    judged.P = TRACKING**2 * np.kron([[1.0, FPS], [FPS, 2.0 * FPS**2]], np.eye(2))
    return judged


def test_one_mode_is_filterpys_kalman_filter_gaps_included():
    states, model = walk(), modes(1)
    states[10:14, 1] = np.nan
    expected, densities, _ = model.follow(states)
    for individual in range(3):
        judged = judge(model, 0, states[1, individual])
        for time in range(1, len(states)):
            if time > 1:
                position = states[time, individual, :2]
                missing = np.isnan(position).any()
                judged.update(None if missing else position)
                if not missing:
                    assert densities[time, individual] == pytest.approx(judged.log_likelihood)
            judged.predict()
            np.testing.assert_allclose(expected[time, individual], judged.x, rtol=1e-9, atol=1e-9)


def test_individuals_observed_in_the_same_frames_share_their_gains():
    """The vectorised filter of several modes, with one, says the same of every individual."""
    states, model = np.stack([walk(seed=seed) for seed in range(3)]), modes(1)
    states[0, 10:14, 1] = np.nan
    states[1, :5, 2] = np.nan
    states[2, :, 0] = np.nan
    one = model.follow(states)
    many = JumpModel.follow(model, states)
    for ours, theirs in zip(one[:2], many[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(one[2].mean, many[2].mean, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(one[2].covariances, many[2].covariances, rtol=1e-7, atol=1e-12)


def test_four_modes_are_filterpys_interacting_models():
    states, model = walk(), modes(4)
    expected, _, beliefs = model.follow(states)
    for individual in range(3):
        filters = [judge(model, mode, states[1, individual]) for mode in range(4)]
        judged = IMMEstimator(filters, np.full(4, 0.25), model.switching)
        for time in range(1, len(states)):
            if time > 1:
                judged.update(states[time, individual, :2])
            if time + 1 < len(states):
                judged.predict()
                ahead = judged.cbar @ np.stack([one.x for one in judged.filters])
                np.testing.assert_allclose(expected[time, individual], ahead, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(beliefs.weights[individual], judged.mu, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(beliefs.mean[individual], judged.x, rtol=1e-8, atol=1e-8)


def test_expected_path_of_switching_modes_is_the_mean_of_drawn_ones():
    states, model = walk(num_individuals=1), modes(4)
    beliefs = model.follow(states)[2]
    drawn = model.draw(beliefs.repeated(20_000), 6, np.random.default_rng(0))
    error = drawn.mean(axis=0) - model.expect(beliefs, 6)
    # 24 means; 5 standard errors.
    assert (np.abs(error) <= 5.0 * drawn.std(axis=0) / np.sqrt(len(drawn))).all()


def test_noise_levels_are_found():
    states = np.stack([walk(75, 16, 0.3, seed=seed) for seed in range(3)])
    baseline = KalmanVelocity()
    baseline.fit_states(states, FPS, Training())
    # A standard deviation from n coordinates has the relative error 1 / sqrt(2 n), and less is
    # known than of noise itself: twice as much, at four standard errors.
    tolerance = 8.0 / np.sqrt(2 * 48 * 75 * 2)
    assert baseline.process_noise == pytest.approx(0.3, rel=tolerance)
    assert baseline.tracking_noise == pytest.approx(TRACKING, rel=tolerance)
    assert baseline.differenced
    assert baseline.num_parameters == 2


def test_with_noisy_tracks_it_beats_plain_constant_velocity_and_draws_cover_the_truth():
    states = np.stack([walk(75, 8, 0.1, 0.1, seed=seed) for seed in range(3)])
    baseline = KalmanVelocity()
    baseline.fit_states(states[:2], FPS, Training())
    history, truth = states[2, :60], states[2, 60:70]
    path = baseline.predict(history, 10, FPS)
    straight = history[-1, :, :2] + history[-1, :, 2:] * np.arange(1, 11)[:, None, None] / FPS
    error = ((path - truth)[..., :2] ** 2).mean()
    assert error < 0.5 * ((straight - truth[..., :2]) ** 2).mean()
    copies = np.broadcast_to(history, (500, *history.shape))
    drawn = baseline.predict(copies, 10, FPS, np.random.default_rng(2))
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    covered = ((truth > low) & (truth < high)).mean()
    # 90 %; paths of 8 individuals in 2 coordinates are 16 independent ones.
    assert abs(covered - 0.9) < 4.0 * np.sqrt(0.9 * 0.1 / 16)


@pytest.mark.slow
def test_circles_are_found_to_be_turns():
    angle, frames = 0.2, np.arange(51)
    path = np.stack([np.cos(angle * frames), np.sin(angle * frames)], axis=-1)
    states = np.concatenate([path[1:], np.diff(path, axis=0) * FPS], axis=-1)[None, :, None]
    baseline = Quick()
    baseline.fit_states(states, FPS, Training())
    ahead = baseline.predict(states[:, :40], 10, FPS)
    truth = states[:, 40:50]
    straight = KalmanVelocity()
    straight.fit_states(states, FPS, Training())
    error = np.abs(ahead - truth).max()
    assert error < 0.1 * np.abs(straight.predict(states[:, :40], 10, FPS) - truth).max()
    assert baseline.num_parameters == 5


def test_it_cannot_run_before_it_is_fitted_nor_at_another_frame_rate():
    baseline = KalmanVelocity()
    with pytest.raises(InputError, match="fit it first"):
        baseline.predict(walk(), 1, FPS)
    baseline.fit_states(walk()[None], FPS, Training())
    with pytest.raises(InputError, match="5 frames per second"):
        baseline.predict(walk(), 1, 2 * FPS)
