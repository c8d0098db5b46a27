"""The ready kernel model: its prior, options, and the posterior of a linear regression."""

import dataclasses

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.models import LatentEdges, Scales, SwarmBatch
from swarmssm.models.parameters import priors_of
from swarmssm.models.presets import kernel
from swarmssm.models.presets.kernel_model import smoothing_prior
from swarmssm.models.transitions import SplineBasis
from swarmssm.simulate import simulate_boids

SCALES = Scales(
    space=2,
    individuals=5,
    dt=0.1,
    centre=(0.0, 0.0),
    low=(-4.0, -4.0),
    high=(4.0, 4.0),
    length=2.0,
    speed=1.0,
    slow=0.5,
    fast=1.5,
    spacing=0.5,
    step=0.05,
    noise=0.0,
    apart=3.0,
)


def test_prior_of_a_kernel_has_the_precision_that_is_documented():
    basis = SplineBasis(3.0, 0.25, 7)
    prior = smoothing_prior(basis, 2.0, 0.3)
    second = np.diff(np.eye(7), 2, axis=0)
    expected = (np.eye(7) + second.T @ second / 0.3**2) / 2.0**2
    np.testing.assert_allclose(prior.precision_matrix.numpy(), expected, rtol=1e-4, atol=1e-4)


def test_kernels_are_in_units_of_what_turns_an_individual_at_its_neighbour():
    """U = 3, l = 0.5."""
    model = kernel(dataclasses.replace(SCALES, speed=3.0), splines=7, repulsion=True)
    assert model.transition.units == pytest.approx((18.0, 6.0))
    expected = smoothing_prior(model.transition.basis, 3.0, 0.3).precision_matrix
    for name in ("attraction", "repulsion", "alignment"):
        own = model.transition._pyro_samples[name]
        torch.testing.assert_close(own.precision_matrix, expected)


def test_a_smooth_prior_prefers_straight_curves():
    basis = SplineBasis(3.0, 0.25, 8)
    straight, bent = torch.linspace(-1.0, 1.0, 8), torch.tensor([-1.0, 1.0] * 4)
    for smoothness in (0.1, 1.0):
        prior = smoothing_prior(basis, 3.0, smoothness)
        assert prior.log_prob(straight) > prior.log_prob(bent)


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({}, ["attraction", "alignment"]),
        ({"repulsion": True}, ["attraction", "repulsion", "alignment"]),
        ({"angular": 2}, ["attraction", "alignment", "modulation"]),
        (
            {"influence": "pair", "responsiveness": True},
            ["attraction", "alignment", "influence", "responsiveness"],
        ),
        ({"radius": "infer"}, ["attraction", "alignment", "radius"]),
    ],
)
def test_options_say_what_is_inferred(options, names):
    model = kernel(SCALES, walls=False, limits=False, **options)
    expected = [f"transition.{name}" for name in [*names, "process_noise"]] + ["emission.noise"]
    assert priors_of(model) == expected


def test_reach_is_that_of_the_graph():
    assert kernel(SCALES).transition.basis.reach == 3.0
    assert kernel(SCALES, reach=2.0).transition.basis.reach == 2.0
    assert kernel(SCALES, radius=1.5).transition.basis.reach == 1.5
    model = kernel(SCALES, edges="radius:2.5")
    assert model.transition.basis.reach == 2.5
    assert isinstance(model.edges, LatentEdges)


def test_priors_are_replaced_by_name():
    model = kernel(
        SCALES, influence="individual", priors={"influence": "LogNormal(0, 0.1)", "wall_gain": 2.0}
    )
    assert model.transition._pyro_samples["influence"].event_shape == (5,)
    assert "transition.wall_gain" not in priors_of(model)
    curve = dist.MultivariateNormal(torch.zeros(10), torch.eye(10))
    model = kernel(SCALES, priors={"attraction": curve})
    torch.testing.assert_close(
        model.transition._pyro_samples["attraction"].covariance_matrix, torch.eye(10)
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"angular": -1}, "angular: it must be a number of cosines"),
        ({"smoothness": 0.0}, "smoothness: it must be positive"),
        ({"influence": "group"}, "influence: it must be one of"),
        ({"observed": "velocities"}, "observed: it must be one of"),
        ({"radius": "far"}, "radius: it must be a number or 'infer'"),
        ({"splines": 3}, "at least 4 basis functions"),
        ({"priors": {"cohesion_gain": 1.0}}, "cohesion_gain"),
    ],
)
def test_what_a_kernel_model_cannot_be_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        kernel(SCALES, **options)


def test_of_known_states_the_most_probable_kernels_are_those_of_ridge_regression():
    """With known noise the density is quadratic in the coefficients: one Newton step is exact."""
    tracks = simulate_boids(
        5,
        40,
        2,
        wall_gain=0.0,
        min_speed=0.0,
        max_speed=float("inf"),
        noise="additive",
        process_noise=0.3,
        seed=1,
    )
    model = kernel(
        SCALES,
        splines=5,
        walls=False,
        limits=False,
        noise="additive",
        observed="states",
        priors={"process_noise": 0.3},
    ).double()

    def tensor(name, *dims):
        return torch.from_numpy(np.array(tracks[name].transpose(*dims).to_numpy(), dtype=float))

    dims = ("trial", "time", "individual", "space")
    position, velocity = tensor("position", *dims), tensor("velocity", *dims)
    graph = tensor("adjacency", "trial", "time", "individual", "neighbor")
    states = torch.cat([position, velocity], -1)
    batch = SwarmBatch.of(states, torch.ones(states.shape[:-1], dtype=torch.bool), graph)
    names = ("transition.attraction", "transition.alignment")

    def negative(flat):
        values = dict(zip(names, flat.split(5), strict=True))
        conditioned = pyro.poutine.condition(model.sample_globals, data=values)
        prior = pyro.poutine.trace(conditioned).get_trace().log_prob_sum()
        return -(model.chain(batch, values).log_prob(states).sum() + prior)

    start = torch.zeros(10, dtype=torch.float64, requires_grad=True)
    slope = torch.autograd.grad(negative(start), start)[0]
    curvature = torch.autograd.functional.hessian(negative, start.detach())
    found = -torch.linalg.solve(curvature, slope).numpy()

    # The same by hand: rows of the regression of accelerations on splines of each pair.
    basis = model.transition.basis
    rows, targets = [], []
    for trial in range(2):
        for step in range(39):
            for i in range(5):
                seen = np.flatnonzero(graph[trial, step, i].numpy())
                row = np.zeros((2, 10))
                for j in seen:
                    apart = position[trial, step, j] - position[trial, step, i]
                    distance = apart.norm()
                    weights = basis(distance, torch.eye(5, dtype=torch.float64)).value.numpy()
                    relative = velocity[trial, step, j] - velocity[trial, step, i]
                    row[:, :5] += np.outer((apart / distance).numpy(), weights) / len(seen)
                    row[:, 5:] += np.outer(relative.numpy(), weights) / len(seen)
                rows.append(row)
                targets.append((velocity[trial, step + 1, i] - velocity[trial, step, i]) / 0.1)
    rows, target = 2.0 * np.concatenate(rows), torch.cat(targets).numpy()
    # The unit of both kernels is 1 / 0.5. The noise of an acceleration is 0.3 / sqrt(dt).
    precision = 0.1 / 0.3**2
    priors = [
        model.transition._pyro_samples[n].precision_matrix for n in ("attraction", "alignment")
    ]
    penalty = torch.block_diag(*priors).numpy()
    expected = np.linalg.solve(precision * rows.T @ rows + penalty, precision * rows.T @ target)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
