"""Iterated smoothers against the most probable path, and a grid over a single number."""

import numpy as np
import pytest
import torch
from oracles.iterated import iterated_smoother
from oracles.sigma_points import SigmaPoints, unscented_kalman

from swarmssm.inference.filtering import extended_kalman, path_log_density, smooth

ABSENT = [(0, slice(0, 2), 2), (0, slice(5, None), 0)]


@pytest.mark.parametrize("kind", ["general", "kinematic"])
def test_a_linear_model_needs_no_iterations(kind, linear_swarm, windows):
    model, batch = linear_swarm(kind), windows(batch=1, absent=ABSENT)
    exact = extended_kalman(model, batch, {})
    for linearizer in (None, SigmaPoints()):
        found = iterated_smoother(model, batch, {}, 1, linearizer)
        torch.testing.assert_close(found.log_evidence, exact.log_evidence, rtol=1e-9, atol=0)
        torch.testing.assert_close(found.smoothed.mean, smooth(exact).mean, rtol=1e-8, atol=1e-9)
        assert (found.change < 1e-6).all()


@pytest.mark.parametrize("kind", ["general", "kinematic"])
def test_a_single_frame_has_no_steps_to_linearize(kind, linear_swarm, windows):
    model, batch = linear_swarm(kind), windows(times=1)
    exact = extended_kalman(model, batch, {})
    for linearizer in (None, SigmaPoints()):
        found = iterated_smoother(model, batch, {}, 1, linearizer)
        torch.testing.assert_close(found.log_evidence, exact.log_evidence)


def joint_density(model, batch, paths):
    seen = model.emission(paths).mask(batch.mask).to_event(2).log_prob(batch.observations)
    return model.chain(batch, {}).log_prob(paths) + seen


def test_it_ends_at_the_most_probable_path(bent_swarm, windows, observed):
    """There the density has no slope, in first states and velocities; and Laplace's evidence."""
    model = bent_swarm()
    batch, _ = observed(model, windows(batch=2, times=7))
    found = iterated_smoother(model, batch, {}, 30)
    assert (found.change < 1e-6).all()
    mean = found.smoothed.mean
    first = mean[:, 0].clone().requires_grad_()
    free = model.transition.stochastic_features(mean[:, 1:]).clone().requires_grad_()
    path = model.transition.path(first, free)
    torch.testing.assert_close(path.detach(), mean, rtol=0, atol=1e-9)
    density = joint_density(model, batch, path)
    slopes = torch.autograd.grad(density.sum(), (first, free))
    # Slopes are of the order of a distance over a variance, here some tens.
    assert max(float(s.abs().max()) for s in slopes) < 1e-5
    # log p(x, z) - log q(z) at the mean: the second term is half the log of |2 pi Sigma|.
    laplace = density.detach() - path_log_density(found.filtered, path.detach())
    torch.testing.assert_close(found.log_evidence, laplace, rtol=1e-9, atol=0)


def grid_judge(model, batch, bend):
    """Return evidence and smoothed means of a single number, by summing over a fine grid."""
    grid = np.linspace(-9, 9, 1801)
    width = grid[1] - grid[0]

    def normal(x, mean, sd):
        return np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))

    move = normal(
        grid[:, None], 0.9 * grid + bend * np.sin(2 * grid), float(model.transition.noise)
    )
    noise = float(model.emission.noise)
    first = normal(grid, float(model.initial.mean[0]), float(model.initial.scale[0]))
    scores = [
        normal(float(x), grid + 0.5 * bend * grid**2, noise) if bool(m) else np.ones_like(grid)
        for x, m in zip(batch.observations[0, :, 0, 0], batch.mask[0, :, 0], strict=True)
    ]
    ahead, log_evidence, forward = first, 0.0, []
    for t, score in enumerate(scores):
        if t:
            ahead = move @ forward[-1] * width
        weight = ahead * score
        total = weight.sum() * width
        log_evidence += np.log(total)
        forward.append(weight / total)
    back, means = np.ones_like(grid), []
    for t in reversed(range(len(scores))):
        posterior = forward[t] * back
        means.append((posterior * grid).sum() / posterior.sum())
        back = move.T @ (scores[t] * back) * width
        back /= back.max()
    return log_evidence, np.array(means[::-1])


METHODS = {
    "extended": lambda *given: extended_kalman(*given, {}),
    "unscented": lambda *given: unscented_kalman(*given, {}),
    "iterated": lambda *given: iterated_smoother(*given, {}, 6).filtered,
    "iterated sigma points": lambda *given: (
        iterated_smoother(*given, {}, 6, SigmaPoints()).filtered
    ),
}


@pytest.mark.parametrize("method", METHODS)
def test_errors_vanish_with_the_bend(method, wave, windows, observed):
    """Against exact sums: at least in proportion to it, and exactly where there is none."""
    errors = []
    for bend in (0.01, 0.005, 0.0):
        model = wave(bend)
        template = windows(batch=1, times=12, individuals=1, missing=[(0, 4, 0)])
        batch, _ = observed(wave(0.01), template, seed=2)
        filtered = METHODS[method](model, batch)
        evidence, means = grid_judge(model, batch, bend)
        smoothed = smooth(filtered).mean[0, :, 0, 0].detach().numpy()
        errors.append(
            (abs(float(filtered.log_evidence) - evidence), np.abs(smoothed - means).max())
        )
    (evidence, mean), (half_evidence, half_mean), (no_evidence, no_mean) = errors
    assert half_evidence < evidence / 1.8
    assert half_mean < mean / 1.8
    # The grid's own error: sums over smooth functions converge faster than any power.
    assert no_evidence < 1e-8
    assert no_mean < 1e-8


def test_negative_iterations_are_refused(linear_swarm, windows):
    with pytest.raises(ValueError, match="0 or more, and it is -1"):
        iterated_smoother(linear_swarm("general"), windows(), {}, -1)
