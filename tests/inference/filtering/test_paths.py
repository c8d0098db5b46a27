"""Drawn paths against the dense posterior of a window."""

from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch

from swarmssm.inference.filtering import draw_paths, extended_kalman, path_log_density

STATE = 4
MISSING = [(0, 2, 1), (0, 3, 1)]
ABSENT = [(0, slice(0, 2), 2), (0, slice(4, None), 0)]
both_kinds = pytest.mark.parametrize("kind", ["general", "kinematic"])
both_windows = pytest.mark.parametrize("absent", [(), ABSENT], ids=["all stay", "come and go"])


@both_kinds
@both_windows
def test_draws_have_the_moments_of_the_joint_posterior(
    kind, absent, linear_swarm, windows, dense_judge
):
    model = linear_swarm(kind)
    batch = windows(batch=1, times=6, missing=MISSING, absent=absent)
    number = 6_000
    drawn = draw_paths(extended_kalman(model, batch, {}), number, seed=3)
    assert drawn.shape == (number, 1, 6, 3, STATE)
    mean, covariance = dense_judge(model, batch, 0).posterior()
    flat = drawn[:, 0].reshape(number, -1).numpy()
    deviation = np.sqrt(np.diag(covariance).clip(0))
    absolute = 1e-12
    assert (np.abs(flat.mean(0) - mean) <= 6 * deviation / np.sqrt(number) + absolute).all()
    # The variance of a product of two Gaussians is at most twice that of their squares.
    spread = np.outer(deviation, deviation) * np.sqrt(2 / number)
    assert (np.abs(np.cov(flat.T) - covariance) <= 6 * spread + absolute).all()


@both_windows
def test_positions_of_a_kinematic_path_follow_from_its_velocities(absent, linear_swarm, windows):
    model = linear_swarm("kinematic")
    batch = windows(batch=1, times=6, absent=absent)
    drawn = draw_paths(extended_kalman(model, batch, {}), 5, seed=3)
    # A chain that checks its arguments refuses paths off the surface.
    assert torch.isfinite(model.chain(batch, {}).log_prob(drawn)).all()
    own = drawn[:, :, :-1, :, :2] + model.transition.dt * drawn[:, :, 1:, :, 2:]
    persists = batch.present[:, 1:] & batch.present[:, :-1]
    assert torch.equal(drawn[:, :, 1:, :, :2][:, persists], own[:, persists])
    assert (drawn[:, ~batch.present] == 0).all()


def test_float32_paths_stay_on_the_surface_and_near_the_float64_ones(linear_swarm, windows):
    model = linear_swarm("kinematic")
    batch = windows(batch=1, times=40)
    exact = draw_paths(extended_kalman(model, batch, {}), 1, torch.Generator().manual_seed(1))
    single = replace(
        batch, observations=batch.observations.float(), adjacency=batch.adjacency.float()
    )
    filtered = extended_kalman(model.float(), single, {})
    drawn = draw_paths(filtered, 50, seed=2)
    assert torch.isfinite(model.chain(single, {}).log_prob(drawn)).all()
    gap = drawn.double().mean(0) - exact[0]
    # Both are within a few posterior deviations (below 1 everywhere) of the same mean.
    assert gap.abs().max() < 6


@both_kinds
@both_windows
def test_log_density_of_paths_is_that_of_the_dense_posterior(
    kind, absent, linear_swarm, windows, dense_judge
):
    model = linear_swarm(kind)
    batch = windows(batch=1, times=6, missing=MISSING, absent=absent)
    filtered = extended_kalman(model, batch, {})
    drawn = draw_paths(filtered, 3, seed=4)
    found = path_log_density(filtered, drawn)
    assert found.shape == (3, 1)
    mean, covariance = dense_judge(model, batch, 0).posterior()
    free = filtered.system.window.stochastic_features[0].reshape(-1).numpy()
    # All else is a function of the free features, so that theirs is the density of the path.
    gap = (drawn[:, 0].reshape(3, -1).numpy() - mean)[:, free]
    spread = covariance[np.ix_(free, free)]
    sign, logdet = np.linalg.slogdet(spread)
    assert sign > 0
    square = (gap * np.linalg.solve(spread, gap.T).T).sum(-1)
    expected = -0.5 * (square + logdet + free.sum() * np.log(2 * np.pi))
    np.testing.assert_allclose(found[:, 0].numpy(), expected, rtol=1e-8)


def test_free_features_are_first_states_and_velocities(linear_swarm, windows):
    batch = windows(batch=1, times=6, absent=ABSENT)
    free = extended_kalman(linear_swarm("kinematic"), batch, {}).system.window.stochastic_features[
        0
    ]
    free = free.reshape(6, 3, STATE)
    assert free[0].tolist() == [[True] * 4, [True] * 4, [False] * 4]
    assert free[2].tolist() == [[False, False, True, True]] * 2 + [[True] * 4]
    assert free[5].tolist() == [[False] * 4] + [[False, False, True, True]] * 2


def test_draws_are_differentiable_in_parameters(linear_swarm, windows):
    """Against a central difference, noise held fixed."""
    model = linear_swarm("kinematic", noise=dist.LogNormal(0.0, 1.0))
    batch = windows(batch=1, times=5, absent=ABSENT)

    def total(noise):
        filtered = extended_kalman(model, batch, {"transition.noise": noise})
        drawn = draw_paths(filtered, 2, seed=5)
        return drawn.square().sum() + path_log_density(filtered, drawn).sum()

    noise = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(total(noise), noise)
    step = 1e-5
    with torch.no_grad():
        expected = (total(noise + step) - total(noise - step)) / (2 * step)
    torch.testing.assert_close(slope, expected, rtol=1e-6, atol=1e-6)
