"""Figures of forces, kernels and maps: what is drawn is what was given, with its units."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from swarmssm.analysis.interpretation.forces.maps import force_maps, raw_force_map
from swarmssm.analysis.interpretation.forces.posterior import TERMS, force_summary, posterior_forces
from swarmssm.analysis.interpretation.kernels.posterior import interaction_kernels
from swarmssm.analysis.interpretation.kernels.truth import true_kernels
from swarmssm.analysis.plots.forces import (
    plot_force_arrows,
    plot_force_magnitudes,
    plot_force_shares,
)
from swarmssm.analysis.plots.kernels import plot_force_maps, plot_kernels, plot_modulation
from swarmssm.inference import Fit
from swarmssm.models.transitions import KernelTransition, SplineBasis

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def in_cm(packed_boids: xr.Dataset) -> xr.Dataset:
    """Boids in centimetres."""
    return packed_boids.assign_attrs(unit="cm")


@pytest.fixture
def fit(in_cm: xr.Dataset, make_fit: Make, make_law: Make) -> Fit:
    """The law of the simulator."""
    found: Fit = make_fit(in_cm, make_law())
    return found


def test_magnitudes_are_drawn_over_time(fit: Fit, in_cm: xr.Dataset) -> None:
    summary = force_summary(posterior_forces(fit, in_cm, 2))
    figure, ax = plot_force_magnitudes(summary, trial="1")
    assert isinstance(figure, Figure)
    lines = {line.get_label(): line for line in ax.lines}
    assert set(lines) == set(TERMS)
    expected = summary["group_magnitude"].sel(quantile=0.5, trial="1", term="separation")
    np.testing.assert_allclose(lines["separation"].get_ydata(), expected)
    assert ax.get_ylabel() == "mean force (cm/s²)"
    assert ax.get_xlabel() == "time (s)"
    same, given = plot_force_magnitudes(summary, Figure().add_subplot())
    assert same is given.figure


def test_shares_are_bars(fit: Fit, in_cm: xr.Dataset) -> None:
    summary = force_summary(posterior_forces(fit, in_cm, 2))
    _, ax = plot_force_shares(summary)
    expected = 100 * summary["share"].sel(quantile=0.5)
    np.testing.assert_allclose([bar.get_width() for bar in ax.patches], expected)


def test_arrows_point_along_the_forces(fit: Fit, in_cm: xr.Dataset) -> None:
    forces = posterior_forces(fit, in_cm, 2)
    _, ax = plot_force_arrows(forces, frame=5, terms=("cohesion",))
    arrows = [one for one in ax.collections if isinstance(one, Quiver)]
    mean = forces["force"].isel(trial=0, time=5).mean("draw").sel(term="cohesion")
    np.testing.assert_allclose(
        np.stack([arrows[-1].U, arrows[-1].V], -1), mean.transpose("individual", "space"), rtol=1e-5
    )
    assert "cm/s²" in ax.get_title()
    assert "x (cm)" in ax.get_xlabel()


def test_kernels_are_drawn_with_the_truth(fit: Fit, in_cm: xr.Dataset) -> None:
    kernels = interaction_kernels(fit, in_cm, draws=2)
    truth = true_kernels(in_cm, kernels)
    _, axes = plot_kernels(kernels, truth=truth)
    lines = {line.get_label(): line for line in axes[0].lines}
    # Curves end where there are hardly any data.
    ends = slice(kernels.attrs["believed_from"], kernels.attrs["believed_to"])
    kernels, truth = kernels.sel(distance=ends), truth.sel(distance=ends)
    assert 0 < kernels.sizes["distance"] < 100
    np.testing.assert_allclose(lines["truth"].get_ydata(), truth["net"])
    np.testing.assert_allclose(lines["truth"].get_xdata(), truth["distance"])
    np.testing.assert_allclose(
        lines["attraction"].get_ydata(), kernels["attraction"].sel(quantile=0.5)
    )
    assert any(label.startswith("repulsion by") for label in lines)
    assert axes[0].get_xlabel() == "distance (cm)"
    assert axes[0].get_ylabel() == "force (cm/s²)"
    assert axes[1].get_ylabel() == "rate of alignment (1/s)"
    low, high = axes[0].get_ylim()
    assert low < float(kernels["net"].min())
    assert high > float(kernels["net"].max())


def test_modulation_is_drawn_in_degrees(in_cm: xr.Dataset, make_fit: Make) -> None:
    basis = SplineBasis(3.0, 1.0, 8)
    ones = torch.ones(basis.size)
    law = KernelTransition(
        2,
        0.1,
        basis=basis,
        attraction=ones,
        alignment=ones,
        modulation=torch.tensor([0.5]),
        process_noise=1e-9,
    )
    kernels = interaction_kernels(make_fit(in_cm, law), in_cm, draws=2)
    _, ax = plot_modulation(kernels)
    angle, factor = ax.lines[-1].get_data()
    np.testing.assert_allclose(factor, 1 + 0.5 * np.cos(np.radians(angle)), atol=1e-6)
    assert plot_kernels(kernels)[1].shape == (2,)


def test_maps_have_one_scale_about_zero(fit: Fit, in_cm: xr.Dataset) -> None:
    maps = force_maps(fit, in_cm, draws=1, bins=6)
    _, axes = plot_force_maps(maps)
    assert axes.shape == (2, 2)
    for line, name in zip(axes, ("turning", "speeding"), strict=True):
        limits = set()
        for ax, source in zip(line, ("model", "raw"), strict=True):
            (mesh,) = (one for one in ax.collections if isinstance(one, QuadMesh))
            limits.add(mesh.get_clim())
            one = maps.sel(source=source).transpose(..., "front_back", "left_right")
            expected = one[name].where(one["count"] >= 10).to_numpy()
            drawn = np.ma.filled(mesh.get_array().astype(float), np.nan).reshape(expected.shape)
            np.testing.assert_allclose(drawn, expected)
        ((low, high),) = limits
        assert low == -high
    assert axes[0, 0].get_xlabel() == "left ← neighbour → right (cm)"


def test_one_map_alone(in_cm: xr.Dataset) -> None:
    figure, axes = plot_force_maps(raw_force_map(in_cm, bins=4))
    assert axes.shape == (2, 1)
    assert axes[0, 0].get_title() == "turning: raw data"
    figure.canvas.draw()


def two_maps(weak: float, strong: float, error: float) -> xr.Dataset:
    """Two maps of 3 x 3 bins: one weak in all, one strong; the latter's middle by chance."""
    value = np.stack([np.full((3, 3), weak), np.full((3, 3), strong)])
    value[1, 1, 1] = 1e6
    errors = np.full_like(value, error)
    errors[1, 1, 1] = 1e6
    dims = ("source", "front_back", "left_right")
    bins = [-1.0, 0.0, 1.0]
    variables = dict.fromkeys(("turning", "speeding"), (dims, value))
    variables |= {f"{name}_error": (dims, errors) for name in ("turning", "speeding")}
    variables["count"] = (dims, np.full(value.shape, 100))
    return xr.Dataset(
        variables, {"source": ["raw", "model"], "front_back": bins, "left_right": bins}
    )


@pytest.mark.parametrize(
    ("strong", "error", "limit"),
    [
        # The stronger map has all of the scale, without the bin that is far off by chance;
        (2.5, 0.1, 2.5),
        # but not where the weaker one could not be seen any more.
        (100.0, 0.1, 3.0),
    ],
)
def test_colours_of_maps_show_both(strong: float, error: float, limit: float) -> None:
    _, axes = plot_force_maps(two_maps(1.0, strong, error))
    for ax in axes.flat:
        (mesh,) = (one for one in ax.collections if isinstance(one, QuadMesh))
        assert mesh.get_clim() == pytest.approx((-limit, limit))


def test_maps_of_which_nothing_is_sure_have_a_scale() -> None:
    _, axes = plot_force_maps(two_maps(1.0, 1.0, 10.0).isel(front_back=[0, 2]))
    (mesh,) = (one for one in axes[0, 0].collections if isinstance(one, QuadMesh))
    assert mesh.get_clim() == (-1.0, 1.0)
