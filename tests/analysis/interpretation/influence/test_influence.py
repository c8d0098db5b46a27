"""Hold influences to derivatives worked by hand, and to what symmetry and absence say of them."""

import math

import numpy as np
import pyro.distributions as dist
import pytest
import torch

from swarmssm import simulate
from swarmssm.analysis.interpretation.influence import posterior as module
from swarmssm.analysis.interpretation.influence.jacobians import (
    acceleration_jacobian,
    has_closed_form,
)
from swarmssm.analysis.interpretation.influence.posterior import influence
from swarmssm.analysis.interpretation.influence.ranks import rank_probabilities
from swarmssm.analysis.interpretation.influence.weights import WEIGHT_SAMPLES
from swarmssm.analysis.posterior.accelerations import acceleration_model, posterior_paths
from swarmssm.errors import InputError
from swarmssm.models.transitions import BoidsTransition, SplineBasis

#: Gains are kept in single precision.
SINGLE = 2e-7
GAINS = {"cohesion_gain": 0.5, "separation_gain": 0.3, "alignment_gain": 0.2}


def jacobians(fit, tracks, **options):
    """Return the derivatives at all frames, (frame, individual, space, individual, state)."""
    paths = posterior_paths(fit, tracks, 1)
    return acceleration_jacobian(
        fit,
        acceleration_model(fit),
        paths.states[0].flatten(0, 1),
        paths.adjacency.flatten(0, 1),
        paths.present.flatten(0, 1),
        paths.parameters[0],
        **options,
    )


@pytest.mark.parametrize("closed_form", [True, False])
def test_derivatives_of_two_boids_by_hand(make_fit, pair, closed_form):
    """a_0 = 0.5 (p_1 - p_0) + 0.3 (p_0 - p_1) / d^2 + 0.2 (v_1 - v_0), d = 2 along x.

    By p_1: 0.5 I - 0.3 / 4 (I - 2 x x^T), that is 0.575 along and 0.425 across; by v_1: 0.2 I.
    """
    fit = make_fit(pair, BoidsTransition(2, 0.1, process_noise=1e-9, **GAINS))
    found = jacobians(fit, pair, closed_form=closed_form)[0]
    by_other = [[0.575, 0.0, 0.2, 0.0], [0.0, 0.425, 0.0, 0.2]]
    np.testing.assert_allclose(found[0, :, 1], by_other, rtol=0, atol=SINGLE)
    np.testing.assert_allclose(found[0, :, 0], -np.array(by_other), rtol=0, atol=SINGLE)
    np.testing.assert_allclose(found[1, :, 0], by_other, rtol=0, atol=SINGLE)


def test_influence_of_two_boids_by_hand(make_fit, pair):
    """With L = 3 and U = 5: 3 sqrt(0.575^2 + 0.425^2), 5 * 0.2 sqrt(2), and their hypotenuse."""
    fit = make_fit(pair, BoidsTransition(2, 0.1, process_noise=1e-9, **GAINS))
    found = influence(fit, pair, 3, length=3.0, speed=5.0)
    position, velocity = 3.0 * math.hypot(0.575, 0.425), 5.0 * 0.2 * math.sqrt(2.0)
    for name, value in (
        ("position_part", position),
        ("velocity_part", velocity),
        ("influence", math.hypot(position, velocity)),
    ):
        for quantile in found["quantile"].values:
            matrix = found[name].sel(quantile=quantile).to_numpy()
            np.testing.assert_allclose(matrix[[0, 1], [1, 0]], value, rtol=SINGLE)
            assert np.isnan(matrix[[0, 1], [0, 1]]).all()
    assert found.attrs["certain"] == 1
    np.testing.assert_allclose(found["outgoing"], math.hypot(position, velocity), rtol=SINGLE)
    np.testing.assert_allclose(found["net"], 0.0, atol=1e-12)
    # Two alike share both ranks.
    np.testing.assert_allclose(found["rank_probability"], 0.5)
    assert found["influence"].attrs["units"] == "cm/s^2"


LAWS = {
    "boids": lambda make: BoidsTransition(2, 0.1, process_noise=1e-9, **GAINS),
    "fading": lambda make: BoidsTransition(
        2, 0.1, process_noise=0.1, radius=1.5, radius_width=0.3, wall_gain=1.0, half_width=1.0,
        relaxation_gain=0.5, preferred_speed=1.0, **GAINS,
    ),
    "velocity": lambda make: BoidsTransition(2, 0.1, form="velocity", process_noise=0.1, **GAINS),
    "kernel": lambda make: make(
        influence=[1.0, 2.0, 0.5, 0.0], responsiveness=[1.0, 0.0, 2.0, 1.0]
    ),
    "angular": lambda make: make(
        basis=SplineBasis(3.0, 0.5, 4), attraction=[-1.0, 0.5, 1.0, 0.2], repulsion=None,
        alignment=[0.5, 0.3, 0.2, 0.1], modulation=[0.4], max_speed=2.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_closed_form_and_differentiation_agree(make_fit, make_kernels, tracks, name):
    """Of different individuals; what noise that grows with one's speed adds is one's own."""
    fit = make_fit(tracks, LAWS[name](make_kernels))
    assert has_closed_form(fit)
    closed, found = (jacobians(fit, tracks, closed_form=form) for form in (True, False))
    others = ~torch.eye(4, dtype=torch.bool)
    closed, found = (j.transpose(2, 3)[:, others] for j in (closed, found))
    assert found.abs().max() > 0.1
    np.testing.assert_allclose(closed, found, rtol=1e-7, atol=1e-9)


def test_differentiation_agrees_with_finite_differences(quick_fit, boids):
    """Of a network, in single precision: central differences of 1e-2 of a scale, within 1 %."""
    tracks = boids.isel(trial=[0], time=slice(5, 8))
    motion = acceleration_model(quick_fit)
    assert not has_closed_form(quick_fit)
    paths = posterior_paths(quick_fit, tracks, 1)
    states, graph, present = paths.states[0, 0], paths.adjacency[0], paths.present[0]
    found = jacobians(quick_fit, tracks)
    scale = torch.tensor(quick_fit.preparation.scaler.scale)
    differences = torch.empty_like(found)
    with torch.no_grad():
        for j in range(5):
            for b in range(4):
                step = torch.zeros_like(states)
                step[:, j, b] = 1e-2 * scale[b]
                ends = [motion.acceleration(states + s, graph, present, {}) for s in (step, -step)]
                differences[..., j, b] = (ends[0] - ends[1]) / (2e-2 * scale[b])
    # Kinks of rectified units are few; rounding is 1e-7 of a scale over 2e-2 and dt.
    error = ((differences - found) * scale).norm() / (found * scale).norm()
    assert error < 0.01


def test_permuted_individuals_have_permuted_influences(make_fit, make_kernels, tracks):
    weights = np.array([1.0, 2.0, 0.5, 3.0])
    order = [2, 0, 3, 1]
    first = influence(make_fit(tracks, make_kernels(influence=weights.tolist())), tracks, 1)
    turned = tracks.isel(individual=order, neighbor=order)
    again = influence(make_fit(turned, make_kernels(influence=weights[order].tolist())), turned, 1)
    assert list(again["individual"].values) == [str(place) for place in order]
    for name in ("influence", "step_influence", "outgoing", "incoming", "pair_weight"):
        # By name, whatever the order.
        other = again[name].sel(individual=first["individual"])
        if "neighbor" in other.dims:
            other = other.sel(neighbor=first["neighbor"])
        np.testing.assert_allclose(other, first[name], rtol=1e-5 if "step" in name else 1e-12)
    assert len(np.unique(first["outgoing"].values.round(6))) == 4


def test_who_does_not_interact_has_exactly_none(make_fit, make_kernels, tracks):
    """Weight and responsiveness 0 of the third: its column and row are 0, the others not."""
    law = make_kernels(influence=[1.0, 1.0, 0.0, 1.0], responsiveness=[1.0, 1.0, 0.0, 1.0])
    found = influence(make_fit(tracks, law), tracks, 1)
    matrix = found["influence"].sel(quantile=0.5).to_numpy()
    alone = np.zeros((4, 4), bool)
    alone[2] = alone[:, 2] = True
    others = ~np.eye(4, dtype=bool)
    assert (matrix[alone & others] == 0.0).all()
    assert (matrix[~alone & others] > 0.1).all()
    assert float(found["outgoing"].sel(individual="2")[0]) == 0.0
    np.testing.assert_allclose(found["weight"][0], [4 / 3, 4 / 3, 0.0, 4 / 3])


def test_weights_scale_influences(make_fit, make_kernels, tracks):
    """Of one that counts three times the column is three times that of weight 1."""
    plain = influence(make_fit(tracks, make_kernels()), tracks, 1)["influence"]
    law = make_kernels(influence=[1.0, 3.0, 1.0, 1.0])
    found = influence(make_fit(tracks, law), tracks, 1)["influence"]
    others = ~np.eye(4, dtype=bool)
    ratio = (found / plain).transpose("quantile", "individual", "neighbor").to_numpy()
    expected = np.broadcast_to([1.0, 3.0, 1.0, 1.0], (3, 4, 4))
    np.testing.assert_allclose(ratio[:, others], expected[:, others], rtol=1e-6)


def test_the_absent_are_left_out(make_fit, make_kernels, tracks):
    """The mean is over the steps in which both are there, and a step without one is NaN."""
    gap = tracks.copy(deep=True)
    for name in ("position", "velocity"):
        gap[name].loc[{"time": gap["time"][1], "individual": "3"}] = np.nan
    fit = make_fit(tracks, make_kernels(repulsion=None))
    found, whole = (influence(fit, each, 1, length=1.0, speed=1.0) for each in (gap, tracks))
    steps = found["step_influence"].sel(quantile=0.5).isel(trial=0)
    assert np.isnan(steps[1].sel(neighbor="3")).all()
    assert np.isnan(steps[1].sel(individual="3")).all()
    expected = steps.mean("time").to_numpy()
    others = ~np.eye(4, dtype=bool)
    mean = found["influence"].sel(quantile=0.5).to_numpy()
    np.testing.assert_allclose(mean[others], expected[others], rtol=1e-6)
    # A mean over two neighbors instead of three in that step: half as much again.
    np.testing.assert_allclose(
        steps[1].sel(individual="0", neighbor="1"),
        1.5 * whole["step_influence"].sel(quantile=0.5, individual="0", neighbor="1")[0, 1],
        rtol=1e-5,
    )


def test_portions_of_time_change_nothing(quick_fit, boids, monkeypatch):
    tracks = boids.isel(time=slice(10))
    whole = influence(quick_fit, tracks, 2)
    monkeypatch.setattr(module, "PAIRS_AT_ONCE", 3 * 25)
    parts = influence(quick_fit, tracks, 2)
    for name in ("influence", "step_influence", "trial_influence"):
        np.testing.assert_allclose(parts[name], whole[name], rtol=1e-5)
    assert whole.attrs["certain"] == 1
    # Four trials: the mean of all is that of the trials' means, all frames being there.
    np.testing.assert_allclose(
        whole["trial_influence"].mean("trial"), whole["influence"].sel(quantile=0.5), rtol=1e-6
    )


def test_stride_takes_each_so_manieth_frame(make_fit, make_kernels, tracks):
    fit = make_fit(tracks, make_kernels())
    every, other = influence(fit, tracks, 1, speed=1.0), influence(
        fit, tracks, 1, speed=1.0, stride=2
    )  # fmt: skip
    np.testing.assert_array_equal(other["time"], tracks["time"][::2])
    np.testing.assert_array_equal(
        other["step_influence"], every["step_influence"].isel(time=[0, 2])
    )


def test_intervals_are_those_of_the_parameters(make_fit, pair):
    """Alignment alone, of LogNormal gain: influence is U sqrt(2) times the gain, in each draw."""
    law = BoidsTransition(
        2, 0.1, process_noise=1e-9, cohesion_gain=0.0, separation_gain=0.0,
        alignment_gain=dist.LogNormal(torch.tensor(0.0), torch.tensor(0.5)),
    )  # fmt: skip
    fit = make_fit(pair, law)
    paths = posterior_paths(fit, pair, 30, 0)
    gains = [float(values["transition.alignment_gain"]) for values in paths.parameters]
    found = influence(fit, pair, speed=2.0, paths=paths)
    expected = np.quantile(np.array(gains) * 2.0 * math.sqrt(2.0), [0.05, 0.5, 0.95])
    np.testing.assert_allclose(found["influence"].sel(individual="0", neighbor="1"), expected)
    assert found.attrs["certain"] == 0
    assert expected[2] > expected[0] > 0


def test_weights_with_a_prior_have_draws(make_fit, make_kernels, tracks):
    prior = dist.LogNormal(torch.zeros(4), 0.5).to_event(1)
    found = influence(make_fit(tracks, make_kernels(influence=prior)), tracks, 2)
    assert found.sizes["sample"] == WEIGHT_SAMPLES
    np.testing.assert_allclose(found["weight"].mean("individual"), 1.0, rtol=1e-6)
    np.testing.assert_allclose(found["weight_rank_probability"].sum("rank"), 1.0)
    np.testing.assert_allclose(found["weight_rank_probability"].sum("individual"), 1.0)
    assert "responsiveness" not in found
    pairs = dist.LogNormal(torch.zeros(4, 4), 0.5).to_event(2)
    found = influence(make_fit(tracks, make_kernels(influence=pairs)), tracks, 2)
    assert found["responsiveness"].sizes == {"sample": WEIGHT_SAMPLES, "individual": 4}
    assert np.isnan(found["pair_weight"].to_numpy()[:, np.arange(4), np.arange(4)]).all()


def test_ranks_by_hand():
    """Three draws of three: the first is first twice, and once shares first and second."""
    scores = np.array([[3.0, 2.0, 1.0], [3.0, 1.0, 2.0], [2.0, 2.0, np.nan]])
    expected = np.array([[2.5, 0.5, 0.0], [0.5, 1.5, 1.0], [0.0, 1.0, 2.0]]) / 3
    np.testing.assert_allclose(rank_probabilities(scores), expected)


@pytest.mark.parametrize(
    ("options", "word"),
    [({"stride": 0}, "stride"), ({"length": -1.0}, "length"), ({"speed": math.inf}, "speed"),
     ({"draws": 0}, "draws")],
)  # fmt: skip
def test_mistakes(make_fit, make_kernels, tracks, options, word):
    with pytest.raises(InputError, match=word):
        influence(make_fit(tracks, make_kernels()), tracks, **options)


def test_one_alone_moves_nobody(make_fit, make_kernels):
    alone = simulate.simulate_boids(1, 5)
    with pytest.raises(InputError, match="one individual"):
        influence(make_fit(alone, make_kernels()), alone)
