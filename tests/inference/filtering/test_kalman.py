"""The Gaussian filter and smoother against filterpy and the dense joint Gaussian."""

from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from filterpy.kalman import KalmanFilter, rts_smoother
from oracles.iterated import iterated_smoother
from oracles.particles import bootstrap_particle_filter
from oracles.sigma_points import unscented_kalman

from swarmssm.errors import WorkError
from swarmssm.graphs import EdgeList
from swarmssm.inference.filtering import draw_paths, extended_kalman, filter_with, smooth
from swarmssm.inference.filtering.affine import Taylor
from swarmssm.inference.filtering.matrices import root
from swarmssm.models import LatentEdges, StateSpaceModel

SPACE, STATE = 2, 4
MISSING = [(0, 2, 1), (0, 3, 1), (1, 0, 0), (1, 5, slice(None))]
ABSENT = [(0, slice(0, 2), 2), (0, slice(5, None), 0), (1, slice(2, 4), 1)]
CASES = {
    "all seen": {},
    "missing frames": {"missing": MISSING},
    "entering and leaving": {"absent": ABSENT},
    "both, with controls": {"missing": MISSING, "absent": ABSENT, "controls": True},
}
both_kinds = pytest.mark.parametrize("kind", ["general", "kinematic"])
all_cases = pytest.mark.parametrize("case", CASES)


def filterpy_run(model, batch, window, dense):
    """Return filterpy's log-likelihood of one window, its means, covariances and matrices."""
    individuals, times = batch.num_individuals, batch.num_times
    joint = individuals * STATE
    judge = KalmanFilter(dim_x=joint, dim_z=individuals * SPACE)
    judge.x, judge.P = dense.mean[:joint], dense.covariance[:joint, :joint]
    sigma = model.emission.noise.numpy()
    pick = np.kron(np.eye(individuals), np.eye(SPACE, STATE))
    total, means, covariances = 0.0, [], []
    for t in range(times):
        if t:
            judge.predict(
                u=np.ones(1),
                B=dense.offsets[t - 1][:, None],
                F=dense.matrices[t - 1],
                Q=dense.noises[t - 1],
            )
        mask = batch.mask[window, t].numpy()
        rows = np.repeat(mask, SPACE)
        if rows.any():
            seen = batch.observations[window, t].numpy()[mask].reshape(-1)
            judge.dim_z = len(seen)
            judge.update(seen, R=np.diag(np.tile(sigma**2, mask.sum())), H=pick[rows])
            total += judge.log_likelihood
        means.append(judge.x.copy())
        covariances.append(judge.P.copy())
    return total, np.array(means), np.array(covariances)


@both_kinds
@all_cases
def test_evidence_is_that_of_filterpy_and_of_the_dense_gaussian(
    kind, case, linear_swarm, windows, dense_judge
):
    model, batch = linear_swarm(kind), windows(**CASES[case])
    filtered = extended_kalman(model, batch, {})
    for window in range(len(batch)):
        dense = dense_judge(model, batch, window)
        total, means, covariances = filterpy_run(model, batch, window, dense)
        evidence = float(filtered.log_evidence[window])
        assert evidence == pytest.approx(dense.log_evidence, rel=1e-10)
        assert evidence == pytest.approx(total, rel=1e-10)
        shape = means.shape
        np.testing.assert_allclose(
            filtered.mean[window].numpy().reshape(shape), means, rtol=1e-9, atol=1e-11
        )
        np.testing.assert_allclose(
            filtered.covariance[window].numpy(), covariances, rtol=1e-9, atol=1e-11
        )


@both_kinds
@pytest.mark.parametrize("case", ["all seen", "missing frames"])
def test_smoothed_moments_are_those_of_filterpy(kind, case, linear_swarm, windows, dense_judge):
    model, batch = linear_swarm(kind), windows(**CASES[case])
    smoothed = smooth(extended_kalman(model, batch, {}))
    for window in range(len(batch)):
        dense = dense_judge(model, batch, window)
        _, means, covariances = filterpy_run(model, batch, window, dense)
        # filterpy's smoother knows no offset, and these models have none; matrix k of it leads to
        # frame k + 1.
        matrices, noises = [*dense.matrices, dense.matrices[-1]], [*dense.noises, dense.noises[-1]]
        xs, ps, _, _ = rts_smoother(means, covariances, matrices, noises)
        np.testing.assert_allclose(
            smoothed.mean[window].numpy().reshape(xs.shape), xs, rtol=1e-8, atol=1e-10
        )
        np.testing.assert_allclose(smoothed.covariance[window].numpy(), ps, rtol=1e-8, atol=1e-10)


@both_kinds
@all_cases
def test_smoothed_moments_are_those_of_the_dense_gaussian(
    kind, case, linear_swarm, windows, dense_judge
):
    model, batch = linear_swarm(kind), windows(**CASES[case])
    smoothed = smooth(extended_kalman(model, batch, {}))
    joint = batch.num_individuals * STATE
    for window in range(len(batch)):
        mean, covariance = dense_judge(model, batch, window).posterior()
        np.testing.assert_allclose(
            smoothed.mean[window].numpy().reshape(-1), mean, rtol=1e-9, atol=1e-10
        )
        for t in range(batch.num_times):
            here = slice(t * joint, (t + 1) * joint)
            np.testing.assert_allclose(
                smoothed.covariance[window, t].numpy(), covariance[here, here], atol=1e-10
            )
            if t + 1 < batch.num_times:
                after = slice((t + 1) * joint, (t + 2) * joint)
                np.testing.assert_allclose(
                    smoothed.lag_covariance[window, t].numpy(), covariance[here, after], atol=1e-10
                )


def test_a_predicted_covariance_without_inverse_is_smoothed(linear_swarm, windows, dense_judge):
    """Positions known to a millionth: what is predicted has half the rank, up to rounding."""
    model, batch = linear_swarm("kinematic", tracking=(1e-6, 1e-6)), windows()
    filtered = extended_kalman(model, batch, {})
    assert torch.linalg.cond(filtered.predicted_covariance[0, -1]) > 1e9
    smoothed = smooth(filtered)
    joint = batch.num_individuals * STATE
    mean, covariance = dense_judge(model, batch, 0).posterior()
    np.testing.assert_allclose(smoothed.mean[0].numpy().reshape(-1), mean, rtol=1e-7, atol=1e-7)
    last = covariance[-joint:, -joint:]
    np.testing.assert_allclose(smoothed.covariance[0, -1].numpy(), last, atol=1e-9)


def test_one_frame_is_the_initial_distribution_and_what_is_seen(linear_swarm, windows):
    model, batch = linear_swarm("kinematic"), windows(times=1)
    filtered = extended_kalman(model, batch, {})
    deviation = torch.hypot(model.initial.scale[:SPACE], model.emission.noise)
    judge = dist.Normal(model.initial.mean[:SPACE], deviation)
    expected = judge.log_prob(batch.observations).sum((-1, -2, -3))
    torch.testing.assert_close(filtered.log_evidence, expected, rtol=1e-12, atol=0)
    smoothed = smooth(filtered)
    torch.testing.assert_close(smoothed.mean, filtered.mean)
    assert smoothed.lag_covariance.shape == (2, 0, 12, 12)
    assert draw_paths(filtered, 3, seed=0).shape == (3, 2, 1, 3, STATE)


@pytest.mark.parametrize("method", [extended_kalman, unscented_kalman])
def test_the_slope_of_the_evidence_is_that_of_differences(method, bent_swarm, windows):
    model = bent_swarm(noise=dist.LogNormal(0.0, 1.0))
    batch = windows(missing=MISSING, absent=ABSENT)

    def evidence(noise):
        return method(model, batch, {"transition.noise": noise}).log_evidence.sum()

    noise = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(evidence(noise), noise)
    step = 1e-5
    with torch.no_grad():
        expected = (evidence(noise + step) - evidence(noise - step)) / (2 * step)
    torch.testing.assert_close(slope, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("method", [extended_kalman, unscented_kalman])
@pytest.mark.parametrize("kind", ["general", "kinematic"])
def test_a_list_of_edges_gives_the_same_numbers(method, kind, linear_swarm, windows):
    model, batch = linear_swarm(kind), windows(absent=ABSENT)
    sparse = replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))
    dense, listed = method(model, batch, {}), method(model, sparse, {})
    torch.testing.assert_close(listed.log_evidence, dense.log_evidence, rtol=1e-12, atol=0)
    torch.testing.assert_close(listed.covariance, dense.covariance, rtol=1e-10, atol=1e-12)


def test_a_latent_graph_is_that_of_those_who_are_there(linear_swarm, windows):
    """Everybody sees everybody who is there, seen by the cameras or not."""
    given, batch = linear_swarm("kinematic"), windows(missing=MISSING, absent=ABSENT)
    there = batch.present.to(torch.float64)
    pairs = there.unsqueeze(-1) * there.unsqueeze(-2) * (1 - torch.eye(3))
    known = extended_kalman(given, replace(batch, adjacency=pairs), {})
    parts = given.initial, given.transition, given.emission
    latent = StateSpaceModel(*parts, LatentEdges("complete")).double()
    found = extended_kalman(latent, replace(batch, adjacency=torch.zeros_like(pairs)), {})
    torch.testing.assert_close(found.log_evidence, known.log_evidence, rtol=1e-12, atol=0)


def test_what_stands_at_missing_observations_says_nothing(linear_swarm, windows):
    model, batch = linear_swarm("general"), windows(missing=MISSING, absent=ABSENT)
    wild = torch.where(batch.mask.unsqueeze(-1), batch.observations, torch.nan)
    found = extended_kalman(model, replace(batch, observations=wild), {})
    expected = extended_kalman(model, batch, {})
    assert torch.equal(found.log_evidence, expected.log_evidence)


def test_absent_individuals_have_no_part(linear_swarm, windows):
    """Means and covariances 0, and the others as if they had never been."""
    model = linear_swarm("kinematic")
    batch = windows(absent=[(slice(None), slice(None), 1)])
    others = [0, 2]
    fewer = replace(
        batch,
        observations=batch.observations[:, :, others],
        mask=batch.mask[:, :, others],
        present=batch.present[:, :, others],
        adjacency=batch.adjacency[:, :, others][..., others],
    )
    found, expected = extended_kalman(model, batch, {}), extended_kalman(model, fewer, {})
    torch.testing.assert_close(found.log_evidence, expected.log_evidence)
    torch.testing.assert_close(found.mean[:, :, others], expected.mean)
    torch.testing.assert_close(found.own_covariance[:, :, others], expected.own_covariance)
    assert (found.mean[:, :, 1] == 0).all()
    assert (found.own_covariance[:, :, 1] == 0).all()


def test_models_and_covariances_that_cannot_be_filtered_are_refused(linear_swarm, windows):
    model, batch = linear_swarm("general"), windows()
    exact = StateSpaceModel(model.initial, model.transition, None)
    for method in (extended_kalman, unscented_kalman, iterated_smoother):
        with pytest.raises(ValueError, match="observes states exactly has nothing to filter"):
            method(exact, batch, {})
    with pytest.raises(ValueError, match="observes states exactly has nothing to filter"):
        bootstrap_particle_filter(exact, batch, {}, 5, 1)

    class Negative(Taylor):
        def observe(self, model, mean, covariance):
            seen = super().observe(model, mean, covariance)
            return seen._replace(noise=-100 * seen.noise)

    with pytest.raises(WorkError, match="of the observations of frame 0 is not positive definite"):
        filter_with(model, batch, {}, Negative())


def test_root_of_a_covariance_of_lower_rank():
    """Two of four directions, and a feature of nobody."""
    thin = torch.randn(5, 4, 2, dtype=torch.float64)
    thin[:, 2] = 0
    matrix = thin @ thin.mT
    found = root(matrix)
    torch.testing.assert_close(found @ found.mT, matrix, rtol=1e-6, atol=1e-6)
    assert torch.equal(found, found.tril())
    assert (found[:, 2] == 0).all()
