"""A pair force is one function: its derivatives, its kernel, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pyro.distributions import LogNormal

from swarmssm.analysis import interaction_kernels, posterior_forces
from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.models import StepInputs, pair_forces
from swarmssm.models.description import UNIT
from swarmssm.models.transitions import (
    BoidsTransition,
    ForceTransition,
    KernelTransition,
    PairForceTransition,
    PairKernel,
    SplineBasis,
)

DT = 0.1
SELF = {"process_noise": 0.3, "wall_gain": 1.0, "half_width": 1.0, "max_speed": 1.5}


def boids(**options):
    gains = {"cohesion_gain": 0.5, "separation_gain": 0.3, "alignment_gain": 0.2}
    return BoidsTransition(2, DT, **gains, **SELF, **options)


def kernel(**options):
    basis = SplineBasis(4, 3.0)
    values = [torch.linspace(-1.0, 1.0, basis.size), torch.linspace(0.2, 0.5, basis.size)]
    return KernelTransition(
        2, DT, basis=basis, attraction=values[0], alignment=values[1], **SELF, **options
    )


def swarm(individuals=4):
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(3, individuals, 4, generator=generator, dtype=torch.float64)
    graph = torch.rand(3, individuals, individuals, generator=generator).double()
    present = torch.ones(3, individuals, dtype=torch.bool)
    present[1, 0] = False
    return states, StepInputs(graph, None, present)


@pytest.mark.parametrize(
    "law",
    [
        boids(),
        boids(form="velocity"),
        boids(radius=2.0, radius_width=0.4),
        boids(form="velocity", radius=2.0, radius_width=0.4, softening=0.1),
        kernel(),
        kernel(modulation=torch.tensor([0.3]), repulsion=torch.ones(12), aggregation="sum"),
        kernel(influence=torch.tensor([0.5, 1.0, 2.0, 1.0]), radius=2.0, radius_width=0.4),
    ],
)
def test_closed_forms_agree_with_the_automatic_derivative(law):
    law = law.double()
    states, inputs = swarm()
    closed = law.linearize(states, inputs)
    law.pair_derivative = lambda *given: ForceTransition.pair_derivative(law, *given)
    automatic = law.linearize(states, inputs)
    for one, other in zip(closed, automatic, strict=True):
        torch.testing.assert_close(one, other)


def test_functions_of_distance_make_boids():
    boid = boids(exponent=1.0).double()
    made = PairForceTransition(
        2,
        DT,
        {
            "cohesion": lambda r, pull: pull * r,
            "separation": lambda r, push: -push / r,
            "alignment": lambda r, turn: turn,
        },
        {"pull": 0.5, "push": 0.3, "turn": 0.2},
        kinds={"separation": PairKernel(over="sum"), "alignment": PairKernel("velocity")},
        **SELF,
    ).double()
    states, inputs = swarm()
    torch.testing.assert_close(made.forces(states, inputs), boid.forces(states, inputs))
    for one, other in zip(
        made.linearize(states, inputs), boid.linearize(states, inputs), strict=True
    ):
        torch.testing.assert_close(one, other)
    distance = torch.linspace(0.1, 2.0, 5).double()
    for one, other in zip(
        made.kernels(distance).values(), boid.kernels(distance).values(), strict=True
    ):
        torch.testing.assert_close(one.expand(5), other.expand(5))


def test_values_of_individuals_go_to_their_own_forces():
    stiffness = torch.tensor([1.0, 2.0, 0.0, 1.0])
    made = PairForceTransition(
        2, DT, {"spring": lambda r, stiffness: stiffness * r}, {"stiffness": stiffness}, **SELF
    ).double()
    states, inputs = swarm()
    force = made.forces(states, inputs)[..., 0, :, :]
    one = PairForceTransition(2, DT, {"spring": lambda r: r}, {}, **SELF).double()
    unit = one.forces(states, inputs)[..., 0, :, :]
    torch.testing.assert_close(force, stiffness.double().unsqueeze(-1) * unit)
    assert made.kernels(torch.ones(3).double())["spring"].shape == (4, 3)


def spring(distance, stiffness, rest):
    return stiffness * (distance - rest)


def springs(scales):
    priors = {"stiffness": scales.prior(time=-2), "rest": scales.prior(length=1)}
    return pair_forces(scales, {"spring": spring}, priors)


def test_the_true_kernel_of_a_simulated_swarm_lies_in_its_band():
    scales = replace(UNIT, individuals=5, noise=0.02)
    truth = {"stiffness": 2.0, "rest": 1.2, "process_noise": 0.3}
    values = {f"transition.{name}": value for name, value in truth.items()}
    drawn = springs(scales).simulate(
        100, 5, values=values | {"emission.noise": 0.02}, graph="complete", seed=1
    )
    tracks = drawn.to_tracks(scales.dt)
    fitted = fit(springs, tracks, epochs=30)
    assert fitted.settings.guide == "linearized"
    kernels = interaction_kernels(fitted, tracks, draws=60)
    assert kernels.attrs["source"] == "model"
    low, _, high = kernels["spring"].to_numpy()
    true = 2.0 * (kernels["distance"].to_numpy() - 1.2)
    assert ((low <= true) & (true <= high)).mean() > 0.9
    # The band is a statement: narrow against the kernel's range.
    assert np.median(high - low) < 0.2 * np.ptp(true)
    forces = posterior_forces(fitted, tracks, draws=3)
    assert "spring" in forces["term"]
    assert float(forces["explained"].min()) > 0.99


@pytest.mark.parametrize(
    ("strengths", "parameters", "message"),
    [
        ({}, {}, "strengths: there must be at least one function"),
        ({"spring": spring}, {"stiffness": 1.0}, "no value for rest"),
        ({"spring": spring}, {"stiffness": 1.0, "rest": 1.0, "w": 1.0}, "no function takes w"),
        ({"f": lambda r, noise: r}, {"noise": 1.0}, "noise is taken"),
    ],
)
def test_what_is_no_pair_force_is_refused(strengths, parameters, message):
    with pytest.raises(InputError, match=message):
        PairForceTransition(2, DT, strengths, parameters, **SELF)


def test_a_function_of_another_shape_is_refused():
    made = PairForceTransition(2, DT, {"f": lambda r: r.unsqueeze(-1)}, {}, **SELF).double()
    with pytest.raises(InputError, match="f: the function must return one number for each"):
        made.kernels(torch.ones(3).double())


def test_priors_are_in_the_units_of_the_tracks():
    metres = UNIT.prior(length=1, time=-2)
    pixels = replace(UNIT, length=100.0, speed=50.0).prior(length=1, time=-2)
    assert isinstance(metres.prior, LogNormal)
    assert float(metres.prior.loc) == pytest.approx(0.0)
    assert float(pixels.prior.loc.exp()) == pytest.approx(100.0 / 2.0**2)
