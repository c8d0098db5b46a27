"""The particle filter against the exact evidence and moments of a linear swarm."""

import pytest
import torch
from oracles.particles import bootstrap_particle_filter

from swarmssm.errors import InputError
from swarmssm.inference.filtering import extended_kalman

ABSENT = [(0, slice(0, 1), 1), (0, slice(4, None), 0)]
REPEATS = 200


@pytest.mark.parametrize(("kind", "resample_below"), [("general", 1.0), ("kinematic", 0.5)])
def test_the_estimated_evidence_is_unbiased(kind, resample_below, linear_swarm, windows, observed):
    """So is, for any number of particles, the product of evidence and filtered mean."""
    model = linear_swarm(kind, tracking=(1.0, 0.8))
    template = windows(batch=1, times=5, individuals=2, missing=[(0, 2, 0)], absent=ABSENT)
    batch, _ = observed(model, template, seed=1)
    exact = extended_kalman(model, batch, {})
    copies = batch.select(torch.zeros(REPEATS, dtype=torch.long))
    cloud = bootstrap_particle_filter(model, copies, {}, 500, seed=2, resample_below=resample_below)
    ratio = (cloud.log_evidence - exact.log_evidence).exp()
    # A spread of more than 2 would leave too few repeats that matter.
    assert 0 < ratio.std() < 2
    assert abs(ratio.mean() - 1) < 6 * ratio.std() / REPEATS**0.5
    last = batch.present[0, -1]
    product = ratio[:, None, None] * cloud.mean[:, -1, last]
    gap = (product.mean(0) - exact.mean[0, -1, last]).abs()
    assert (gap < 6 * product.std(0) / REPEATS**0.5).all()
    assert (cloud.states[..., ~batch.present[0], :] == 0).all()


def test_weights_and_draws_tell_the_filtered_moments(linear_swarm, windows, observed):
    model = linear_swarm("kinematic")
    batch, _ = observed(model, windows(batch=1, times=4, individuals=1), seed=3)
    exact = extended_kalman(model, batch, {})
    particles, number = 40_000, 20_000
    cloud = bootstrap_particle_filter(model, batch, {}, particles, seed=4)
    torch.testing.assert_close(
        cloud.log_weights.logsumexp(0), torch.zeros(1, 4, dtype=torch.float64)
    )
    variance = exact.covariance.diagonal(dim1=-2, dim2=-1).reshape(exact.mean.shape)
    # Weighted means vary like those of as many draws as the effective number; resampling before
    # adds at most as much again for each frame.
    size = 1 / (4 / cloud.effective_size.min())
    assert ((cloud.mean - exact.mean).abs() < 6 * (variance / size).sqrt()).all()
    assert ((cloud.variance / variance - 1).abs() < 6 * (2 / size) ** 0.5).all()
    drawn = cloud.draw(number, seed=5)
    assert drawn.shape == (number, 1, 4, 1, 4)
    assert ((drawn.mean(0) - cloud.mean).abs() < 6 * (variance / number).sqrt()).all()


def test_the_seed_alone_decides(linear_swarm, windows):
    model, batch = linear_swarm("kinematic"), windows(times=3)

    def run(seed):
        return bootstrap_particle_filter(model, batch, {}, 20, seed).states

    torch.manual_seed(0)
    before = torch.random.get_rng_state()
    first = run(1)
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.manual_seed(5)
    assert torch.equal(run(1), first)
    assert not torch.equal(run(2), first)
    generators = [torch.Generator().manual_seed(3) for _ in range(2)]
    assert torch.equal(run(generators[0]), run(generators[1]))


def test_mistakes_are_refused(linear_swarm, windows):
    model, batch = linear_swarm("general"), windows(times=3)
    with pytest.raises(InputError, match="particles must be at least 1"):
        bootstrap_particle_filter(model, batch, {}, 0, 1)
    with pytest.raises(InputError, match="resample_below must be within 0 and 1"):
        bootstrap_particle_filter(model, batch, {}, 5, 1, resample_below=1.5)
