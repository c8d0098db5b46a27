"""Kernels: those of known laws, projections, ranges and numbers of neighbours."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyro.distributions as dist
import pytest
import torch
import xarray as xr

from swarmssm.analysis.interpretation.kernels.posterior import (
    _crossing,
    interaction_kernels,
)
from swarmssm.analysis.interpretation.kernels.truth import kernel_agreement, true_kernels
from swarmssm.analysis.interpretation.verdict import verdict_of
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.errors import InputError
from swarmssm.models.transitions import KernelTransition, SplineBasis
from swarmssm.tracks import make_tracks

Make = Callable[..., Any]


def middle(kernels: xr.Dataset, name: str) -> np.ndarray:
    """Return the median curve of a kernel."""
    return kernels[name].sel(quantile=0.5).to_numpy()


def degree_of(tracks: xr.Dataset) -> float:
    """Return the mean number of neighbours."""
    return float(tracks["adjacency"].sum("neighbor").mean())


def test_kernels_of_boids_with_known_gains(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    kernels = interaction_kernels(make_fit(packed_boids, make_law()), packed_boids, draws=3)
    r = kernels["distance"].to_numpy()
    degree = degree_of(packed_boids)
    np.testing.assert_allclose(middle(kernels, "attraction"), 0.5 * r, rtol=1e-5)
    np.testing.assert_allclose(middle(kernels, "repulsion"), -0.3 / r, rtol=1e-5)
    np.testing.assert_allclose(middle(kernels, "alignment"), 0.2, rtol=1e-5)
    np.testing.assert_allclose(middle(kernels, "net"), 0.5 * r - degree * 0.3 / r, atol=1e-5)
    np.testing.assert_allclose(kernels["neighbors"], degree)
    assert "modulation" not in kernels
    # The zero is found between two of the distances, as if net were straight there.
    step = r[1] - r[0]
    np.testing.assert_allclose(
        kernels["preferred_distance"], np.sqrt(0.3 * degree / 0.5), atol=0.5 * step
    )
    truth = true_kernels(packed_boids, kernels)
    agreement = kernel_agreement(kernels, truth)
    assert list(agreement["kernel"].to_numpy()) == ["attraction", "repulsion", "alignment", "net"]
    assert float(agreement["error"].max()) < 1e-5
    # Alignment is as strong at the longest distance as anywhere.
    assert float(kernels["alignment_range_open"]) == 1.0
    assert kernels["net"].attrs["units"] == "length units/s^2"
    assert kernels.attrs["source"] == "model"


def test_kernels_of_the_velocity_form_are_accelerations(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    fit = make_fit(packed_boids, make_law(form="velocity"))
    kernels = interaction_kernels(fit, packed_boids, draws=1)
    r = kernels["distance"].to_numpy()
    np.testing.assert_allclose(middle(kernels, "attraction"), 0.5 * r / 0.1, rtol=1e-5)
    np.testing.assert_allclose(middle(kernels, "alignment"), 0.2 / 0.1, rtol=1e-5)


def test_bands_are_those_of_the_parameters(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    law = make_law(cohesion_gain=dist.LogNormal(torch.tensor(-0.7), torch.tensor(0.3)))
    fit = make_fit(packed_boids, law)
    kernels = interaction_kernels(fit, packed_boids, draws=50, distances=[0.5, 1.0, 2.0], seed=3)
    drawn = fit.parameters(50, seed=3)["transition.cohesion_gain"].to_numpy()
    np.testing.assert_allclose(kernels["attraction_draws"].sel(distance=2.0), 2.0 * drawn)
    expected = np.quantile(drawn, [0.05, 0.5, 0.95], method="weibull")
    np.testing.assert_allclose(kernels["attraction"].sel(distance=1.0), expected, rtol=1e-6)
    again = interaction_kernels(fit, packed_boids, draws=50, distances=[0.5, 1.0, 2.0], seed=3)
    xr.testing.assert_identical(kernels, again)


def test_gains_of_individuals_are_averaged(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    gains = torch.linspace(0.0, 1.0, 6)
    kernels = interaction_kernels(
        make_fit(packed_boids, make_law(cohesion_gain=gains)), packed_boids, draws=1
    )
    expected = 0.5 * kernels["distance"].to_numpy()
    np.testing.assert_allclose(middle(kernels, "attraction"), expected, rtol=1e-5)


def spline_law(**options: Any) -> KernelTransition:
    """Return a law of kernels with fixed, wavy coefficients."""
    basis = SplineBasis(3.0, 1.0, 8)
    wave = torch.sin(torch.arange(float(basis.size)))
    chosen = {
        "attraction": wave,
        "alignment": 0.5 + 0.1 * wave,
        "process_noise": 1e-9,
        **options,
    }
    return KernelTransition(2, 0.1, basis=basis, **chosen)


def test_kernels_of_a_kernel_transition(packed_boids: xr.Dataset, make_fit: Make) -> None:
    law = spline_law(modulation=torch.tensor([0.4]))
    kernels = interaction_kernels(make_fit(packed_boids, law), packed_boids, draws=1)
    r = torch.tensor(kernels["distance"].to_numpy())
    own = law.kernels(r)
    np.testing.assert_allclose(middle(kernels, "attraction"), own["attraction"].numpy(), atol=1e-6)
    np.testing.assert_allclose(middle(kernels, "net"), middle(kernels, "attraction"))
    assert "repulsion" not in kernels
    angle = kernels["angle"].to_numpy()
    np.testing.assert_allclose(middle(kernels, "modulation"), 1 + 0.4 * np.cos(angle), atol=1e-6)


def test_what_is_summed_counts_for_each_neighbour(packed_boids: xr.Dataset, make_fit: Make) -> None:
    fit = make_fit(packed_boids, spline_law(aggregation="sum"))
    kernels = interaction_kernels(fit, packed_boids, draws=1)
    expected = degree_of(packed_boids) * middle(kernels, "attraction")
    np.testing.assert_allclose(middle(kernels, "net"), expected, rtol=1e-6)
    assert kernels.attrs["attraction_over_neighbors"] == "sum"


def test_weights_of_individuals_scale_the_kernels(packed_boids: xr.Dataset, make_fit: Make) -> None:
    influence = torch.tensor([2.0, 0.0, 1.0, 1.0, 1.0, 4.0])
    plain = interaction_kernels(make_fit(packed_boids, spline_law()), packed_boids, draws=1)
    weighted = interaction_kernels(
        make_fit(packed_boids, spline_law(influence=influence)), packed_boids, draws=1
    )
    np.testing.assert_allclose(middle(weighted, "net"), 1.5 * middle(plain, "net"), rtol=1e-5)


def test_projection_finds_smooth_kernels(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    fit = make_fit(packed_boids, make_law(nameless, separation_gain=0.0))
    kernels = interaction_kernels(fit, packed_boids, draws=30)
    assert kernels.attrs["source"] == "projection"
    assert float(kernels["projection_r2"].min()) > 0.9999
    r = kernels["distance"].to_numpy()
    # Straight lines are splines, and have no second differences: nothing is lost.
    np.testing.assert_allclose(middle(kernels, "attraction"), 0.5 * r, atol=0.01)
    np.testing.assert_allclose(middle(kernels, "alignment"), 0.2, atol=0.01)


def test_neighbours_explain_nothing_of_a_law_without_them(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    """Of speed regulation alone the individual's own terms explain all that is explained."""
    gains = {"separation_gain": 0.0, "cohesion_gain": 0.0, "alignment_gain": 0.0}
    gains |= {"relaxation_gain": 0.5, "preferred_speed": 1.0}
    alone = interaction_kernels(
        make_fit(packed_boids, make_law(nameless, **gains)), packed_boids, draws=10
    )
    assert float(alone["projection_r2"].median()) > 0.5
    assert float(np.abs(alone["neighbor_r2"]).max()) < 0.02
    assert verdict_of({"kernels": alone}).startswith("Neighbours explain")
    assert "not surely above 0" in verdict_of({"kernels": alone})
    gains["cohesion_gain"] = 0.5
    pulled = interaction_kernels(
        make_fit(packed_boids, make_law(nameless, **gains)), packed_boids, draws=10
    )
    assert float(pulled["neighbor_r2"].min()) > 0.1


def test_projection_of_a_law_of_kernels(packed_boids: xr.Dataset, make_fit: Make) -> None:
    fit = make_fit(packed_boids, spline_law())
    own = interaction_kernels(fit, packed_boids, draws=1)
    seen = interaction_kernels(fit, packed_boids, draws=20, projected=True)
    agreement = kernel_agreement(seen, own.sel(quantile=0.5))
    assert float(agreement["error"].max()) < 0.02
    assert float(seen["projection_r2"].min()) > 0.999


def test_bands_of_a_projection_widen_where_it_does_not_fit(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    smooth = make_fit(packed_boids, make_law(nameless, separation_gain=0.0))
    pushed = make_fit(packed_boids, make_law(nameless, separation_gain=0.3))

    def width(fit: Any) -> float:
        kernels = interaction_kernels(fit, packed_boids, draws=40)
        band = kernels["attraction"].sel(quantile=0.95) - kernels["attraction"].sel(quantile=0.05)
        return float((band * kernels["density"]).sum() / kernels["density"].sum())

    # A push that is summed is none of the mean over neighbours.
    assert width(pushed) > 20 * width(smooth)


def test_density_and_neighbours_by_hand(make_fit: Make, make_law: Make) -> None:
    # Three in a row at distances 1 and 2 sit still; the middle one sees both, the first nobody.
    place = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(4, 3, 2))
    graph = np.array([[0, 0, 0], [1, 0, 1], [0, 1, 0]])
    tracks = make_tracks(
        np.broadcast_to(place, (4, 3, 2)) + 1e-6 * np.arange(4)[:, None, None],
        fps=10,
        velocity=velocity,
        adjacency=np.broadcast_to(graph, (4, 3, 3)),
    )
    kernels = interaction_kernels(
        make_fit(tracks, make_law()), tracks, draws=1, distances=np.linspace(0.1, 2.1, 21)
    )
    np.testing.assert_allclose(kernels["neighbors"], 1.0)
    np.testing.assert_allclose(kernels["neighbors_spread"], [0.0, 1.0, 2.0])
    density = kernels["density"]
    step = 0.1
    assert float(density.sum()) * step == pytest.approx(1.0)
    assert float(density.sel(distance=1.0, method="nearest")) * step == pytest.approx(
        1 / 3, abs=0.01
    )
    assert float(density.sel(distance=2.0, method="nearest")) * step == pytest.approx(
        2 / 3, abs=0.01
    )


def test_ranges_by_hand(packed_boids: xr.Dataset, make_fit: Make) -> None:
    basis = SplineBasis(3.0, 1.0, 8)
    short = torch.zeros(basis.size)
    short[1] = 1.0
    law = KernelTransition(
        2, 0.1, basis=basis, attraction=short, alignment=torch.ones(basis.size), process_noise=1e-9
    )
    kernels = interaction_kernels(make_fit(packed_boids, law), packed_boids, draws=1)
    r, net = kernels["distance"].to_numpy(), middle(kernels, "net")
    low, high = kernels.attrs["believed_from"], kernels.attrs["believed_to"]
    dense = (kernels["density"] > 0.02 * kernels["density"].max()).to_numpy()
    inside = (r >= low) & (r <= high) & dense
    strong = inside & (np.abs(net) >= 0.1 * np.abs(net[inside]).max())
    assert strong[inside][:3].any()
    assert not strong[inside][-3:].any()
    assert float(kernels["interaction_range_open"]) == 0.0
    np.testing.assert_allclose(kernels["interaction_range"], r[strong].max())


def test_sign_changes_by_hand() -> None:
    distance, values = np.array([1.0, 2.0, 3.0, 5.0]), np.array([1.0, -1.0, -1.0, 3.0])
    assert _crossing(distance, values, np.array([True, True, True])) == pytest.approx(3.5)
    assert np.isnan(_crossing(distance, values, np.array([True, True, False])))
    assert np.isnan(_crossing(distance, -np.ones(4), np.array([True, True, True])))


def test_agreement_by_hand() -> None:
    distance = [1.0, 2.0, 3.0, 4.0]
    curve = np.array([[1.8, 1.8, 1.8, 1.8], [2.2, 2.2, 2.2, 2.2], [2.4, 2.4, 2.4, 2.4]])
    kernels = xr.Dataset(
        {"net": (("quantile", "distance"), curve), "density": ("distance", [0.5, 0.5, 0.0, 0.0])},
        {"quantile": [0.05, 0.5, 0.95], "distance": distance},
    )
    truth = xr.Dataset({"net": ("distance", [2.0, 2.5, 9.0, 9.0])}, {"distance": distance})
    found = kernel_agreement(kernels, truth)
    expected = np.sqrt((0.2**2 + 0.3**2) / (2.0**2 + 2.5**2))
    assert found["error"].item() == pytest.approx(expected)
    assert found["coverage"].item() == pytest.approx(0.5)
    with pytest.raises(InputError, match="distances"):
        kernel_agreement(kernels, truth.isel(distance=slice(2)))


def test_quantiles_hold_another_draw_with_the_stated_probability() -> None:
    np.testing.assert_allclose(quantiles(np.arange(1.0, 20.0)), [1.0, 10.0, 19.0])
    np.testing.assert_allclose(quantiles(np.array([[np.nan, 3.0], [np.nan, 5.0]])).T[1], [3, 4, 5])
    assert np.isnan(quantiles(np.array([[np.nan], [np.nan]]))).all()


def test_errors(packed_boids: xr.Dataset, make_fit: Make, make_law: Make) -> None:
    fit = make_fit(packed_boids, make_law())
    with pytest.raises(InputError, match="draws"):
        interaction_kernels(fit, packed_boids, draws=0)
    with pytest.raises(InputError, match="distances"):
        interaction_kernels(fit, packed_boids, draws=1, distances=[0.0, 1.0])
    with pytest.raises(InputError, match="distances"):
        interaction_kernels(fit, packed_boids, draws=1, distances=[2.0, 1.0])
    alone = packed_boids.assign(adjacency=0 * packed_boids["adjacency"])
    with pytest.raises(InputError, match="nobody has a neighbour"):
        interaction_kernels(fit, alone, draws=1)
