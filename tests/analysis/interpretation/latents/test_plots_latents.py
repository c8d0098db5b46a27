"""Figures of latents draw the numbers of the dataset."""

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.interpretation.latents.alignment import compare_latents
from swarmssm.analysis.plots.latents import (
    plot_latents,
    plot_rotated_axes,
    plot_sources,
)


@pytest.fixture(scope="module")
def alignment():
    generator = np.random.default_rng(0)
    force = generator.standard_normal((3, 40, 2, 2, 2))
    noise = generator.standard_normal((3, 40, 2, 3))
    latents = xr.DataArray(
        np.concatenate([force.reshape(3, 40, 2, 4), noise], -1),
        dims=("trial", "time", "individual", "latent"),
        coords={"latent": list("abcdefg"), "kind": ("latent", ["latent"] * 7)},
    )
    target = xr.DataArray(
        force,
        dims=("trial", "time", "individual", "term", "space"),
        coords={"term": ["cohesion", "wall"], "space": ["x", "y"]},
    )
    before = [latents.copy(data=generator.standard_normal(latents.shape))]
    return compare_latents(latents, target, {"noise": noise}, before, fps=10.0, shifts=39)


def test_heat_map_shows_and_marks_what_is_there(alignment):
    _, ax = plot_latents(alignment)
    (image,) = ax.images
    values = alignment["latent_r2"].sel(probe="linear").to_numpy().reshape(7, 4)
    np.testing.assert_allclose(image.get_array(), np.clip(values, 0, 1))
    np.testing.assert_allclose(image.get_array(), np.eye(7, 4), atol=0.1)
    # Each of the first four latents is a component: four dots, on the diagonal.
    marks = {(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in ax.lines}
    assert marks == {(k, k) for k in range(4)}
    assert [t.get_text() for t in ax.get_xticklabels()] == [
        "cohesion x",
        "cohesion y",
        "wall x",
        "wall y",
    ]


def test_of_many_latents_the_best_are_drawn_in_their_order(alignment):
    figure, ax = plot_latents(alignment, most=4)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["a", "b", "c", "d"]
    assert "best 4 of 7" in ax.get_title()
    again, same = plot_latents(alignment, ax)
    assert (again, same) == (figure, ax)


def test_sources_are_rows(alignment):
    _, ax = plot_sources(alignment)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["latents (7)", "noise (3)"]
    lines = {line.get_label(): np.asarray(line.get_xydata(), float) for line in ax.lines}
    # Latents tell all and for sure; noise, whose dot is open, is not among the filled ones.
    assert lines["cohesion"].shape == (1, 2)
    assert lines["cohesion"][0, 0] == pytest.approx(1.0, abs=1e-3)
    assert round(lines["cohesion"][0, 1]) == 0
    assert "before training" in lines


def test_rotated_axes_are_the_components(alignment):
    _, ax = plot_rotated_axes(alignment)
    (image,) = ax.images
    np.testing.assert_allclose(image.get_array(), np.eye(4), atol=0.1)
