"""What a fit shows of itself is true of it."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from swarmssm.inference import fit
from swarmssm.inference.convergence import convergence
from swarmssm.inference.summary import posterior_table
from swarmssm.models.units import unit_text, units_of
from swarmssm.simulate import simulate_boids


@pytest.fixture(scope="module")
def small():
    tracks = simulate_boids(individuals=3, steps=40, observation_noise=0.02, seed=0)
    tracks.attrs["unit"] = "cm"
    return fit("boids", tracks, guide="linearized", steps=3, fractions=(1, 0, 0))


def test_units_follow_from_the_rule(small):
    units = small.summary(draws=50)["unit"]
    assert units["cohesion_gain"] == "1/s^2"
    assert units["separation_gain"] == "cm^2/s^2"  # of a push of 1 / distance
    assert units["max_speed"] == "cm/s"
    assert units["noise"] == "cm"
    velocities = small.model.transition
    velocities._form, form = "velocity", velocities._form
    assert units_of(small.model, "")["transition.cohesion_gain"] == "1/s"
    velocities._form = form
    assert unit_text((1, -1.5), "") == "length/s^1.5"


def test_a_fit_introduces_itself(small):
    text = repr(small)
    assert len(text) < 600
    assert "boids" in text
    assert "3 individuals, 40 frames, 10 frames per second" in text
    assert small.convergence.verdict in text
    page = small._repr_html_()
    assert "cohesion_gain" in page
    assert "cm/s" in page


def test_posteriors_are_compared_with_priors(small):
    drawn = small.parameters(500)
    name = "transition.cohesion_gain"
    prior = small.model.transition._pyro_samples["cohesion_gain"]

    def note(values):
        changed = drawn.assign({name: ("draw", np.asarray(values))})[[name]]
        return posterior_table(small.model, changed, "cm", 8).loc["cohesion_gain"]

    own = prior.sample((500,)).numpy()
    assert note(own)["note"].startswith("as its prior")
    far = np.exp(prior.loc.item() + 6.0 * prior.scale.item()) * np.exp(0.01 * np.log(own))
    assert note(far)["note"].endswith("prior sd from its prior")
    assert note(np.exp(prior.loc.item()) * np.exp(0.1 * np.random.default_rng(0).normal(size=500)))[
        "note"
    ] == ("")
    fixed = note(np.full(500, 9.74))
    assert fixed["note"] == "fixed"
    assert np.isnan([fixed["low"], fixed["high"]]).all()


def test_many_numbers_are_one_row(small):
    name = "transition.half_width"
    drawn = small.parameters(50)[[name]]
    assert list(posterior_table(small.model, drawn, "", 2).index) == [
        "half_width[0]",
        "half_width[1]",
    ]
    row = posterior_table(small.model, drawn, "", 1).loc["half_width"]
    assert np.isnan(row["mean"])
    assert row["note"].startswith("2 numbers")


@pytest.mark.parametrize(
    ("loss", "rests"),
    [
        (np.linspace(5.0, 1.0, 100), False),
        (1.0 + 4.0 * np.exp(-np.arange(100) / 5.0), True),
        (1.0 + 4.0 * np.exp(-np.arange(100) / 60.0), False),
        (1.0 + 0.1 * np.random.default_rng(0).normal(size=100), True),
        (np.linspace(5.0, 1.0, 6), False),
    ],
)
def test_a_loss_that_still_falls_has_not_converged(small, loss, rests):
    found = convergence(pd.DataFrame({"loss": loss}))
    assert found.converged is rests
    assert found.verdict.startswith("Converged" if rests else "Not")
    other = dataclasses.replace(small, history=pd.DataFrame({"loss": loss}))
    assert found.verdict in repr(other)
