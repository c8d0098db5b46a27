"""The SINDy autoencoder: its derivatives, and a motion that it is known to learn."""

import numpy as np
import pytest
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.sindy_autoencoder import (
    SindyAutoencoder,
    Sizes,
    SparseAutoencoder,
    TangentNetwork,
)

FPS = 10.0


class Small(SindyAutoencoder):
    """With few steps and a narrow network."""

    steps = 400
    batch = 128
    widths = (24, 12)
    learning_rate = 2e-2


def oscillators(num_trials=6, num_times=60, seed=0):
    """Individuals on springs to the origin, 1.5 a second squared, with a drag of 0.1 a second."""
    random = np.random.default_rng(seed)
    position, velocity = random.standard_normal((2, num_trials, 3, 2))
    states = []
    for _ in range(num_times):
        states.append(np.concatenate([position, velocity], axis=-1))
        velocity = velocity + (-1.5 * position - 0.1 * velocity) / FPS
        position = position + velocity / FPS
    return np.stack(states, axis=1)


def test_velocities_are_carried_by_the_chain_rule():
    torch.manual_seed(0)
    network = TangentNetwork((5, 7, 4, 3)).double()
    point, velocity = torch.randn(2, 6, 5, dtype=torch.float64)
    found = network(point, velocity)
    expected = torch.autograd.functional.jvp(
        lambda at: network(at, velocity)[0], point, velocity, strict=False
    )
    torch.testing.assert_close(found[0], expected[0])
    torch.testing.assert_close(found[1], expected[1])


def test_the_library_holds_all_products_up_to_the_third():
    network = SparseAutoencoder(Sizes(4, 2, 1, (3,)))
    latent, controls = torch.tensor([[2.0, 3.0]]), torch.tensor([[7.0]])
    expected = [1.0, 2, 3, 4, 6, 9, 8, 12, 18, 27, 7]
    assert network.library(latent, controls)[0].tolist() == expected
    assert network.coefficients.shape == (11, 2)


@pytest.mark.slow
def test_oscillators_are_learned_and_small_coefficients_dropped():
    states = oscillators()
    baseline = Small()
    baseline.fit_states(states[:4], FPS, Training(states[4:]))
    predicted = baseline.one_step(states[4:], FPS)[:, 5:, :, 2:]
    last, truth = states[4:, 4:-1, :, 2:], states[4:, 5:, :, 2:]
    # Staying with the last velocity is what it has to improve on.
    assert ((predicted - truth) ** 2).mean() < 0.05 * ((last - truth) ** 2).mean()
    active = baseline.network.active
    kept = baseline.network.coefficients[active.bool()].abs()
    assert 0 < active.sum() < active.numel()
    assert (
        len(kept)
        + sum(
            weight.numel()
            for part in (baseline.network.encoder, baseline.network.decoder)
            for weight in part.parameters()
        )
        == baseline.num_parameters
    )
