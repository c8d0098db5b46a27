"""Latents over time are drawn as the posterior has them."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure

from swarmssm.analysis.plots.latent_paths import plot_latent_paths
from swarmssm.errors import InputError

DIMS = ("trial", "time", "individual", "latent")


@pytest.fixture
def posterior():
    """Two trials, 20 frames, 4 individuals, 8 latents; latent k of individual i is i + k sin(t)."""
    time = np.arange(20) * 0.1
    wave = np.sin(time)[:, None, None]
    mean = np.arange(4.0)[:, None] + np.arange(8.0) * wave
    mean = np.stack([mean, mean + 100.0])
    mean[0, 5:8, 1] = np.nan
    mean[0, :, 2] = np.nan
    sd = np.where(np.isnan(mean), np.nan, 0.5)
    coords = {
        "trial": ["one", "two"],
        "time": time,
        "individual": list("abcd"),
        "latent": np.arange(8),
    }
    return xr.Dataset({"mean": (DIMS, mean), "sd": (DIMS, sd)}, coords)


def bands(ax):
    return [c for c in ax.collections if isinstance(c, FillBetweenPolyCollection)]


def test_mean_and_band_of_each_individual(posterior):
    figure, axes = plot_latent_paths(posterior, individuals=["a", "b"], latents=[3, 1], level=0.9)
    assert isinstance(figure, Figure)
    assert [ax.get_ylabel() for ax in axes] == ["latent 3", "latent 1"]
    expected = posterior["mean"].sel(trial="one", latent=3)
    for line, name in zip(axes[0].lines, "ab", strict=True):
        np.testing.assert_array_equal(line.get_xdata(), posterior["time"])
        np.testing.assert_array_equal(line.get_ydata(), expected.sel(individual=name))
    # 1.6449 standard deviations to each side hold 90 % of a Gaussian.
    corners = bands(axes[0])[0].get_paths()[0].vertices
    first = corners[corners[:, 0] == 0.0][:, 1]
    assert first.min() == pytest.approx(-0.5 * 1.644854, abs=1e-6)
    assert first.max() == pytest.approx(0.5 * 1.644854, abs=1e-6)
    # What is not known is a gap: the band of b has two pieces.
    assert len(bands(axes[0])[1].get_paths()) == 2
    assert axes[-1].get_xlabel() == "time (s)"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]


def test_draws_are_taken_where_there_are(posterior):
    draws = np.array([0.0, 1.0, 2.0, 3.0, 10.0])
    states = draws[:, None, None, None, None] + posterior["mean"].to_numpy()
    drawn = posterior.assign(states=(("draw", *DIMS), states))
    _, axes = plot_latent_paths(drawn, individuals=["a"], latents=[0], level=0.5)
    corners = bands(axes[0])[0].get_paths()[0].vertices
    # The quartiles of 0, 1, 2, 3, 10 are 1 and 3.
    assert (corners[:, 1].min(), corners[:, 1].max()) == (1.0, 3.0)


def test_by_default_those_that_tell_most_of_those_that_are_there(posterior):
    figure, axes = plot_latent_paths(posterior)
    # Latent k varies by k; c is not observed in the first trial.
    assert [ax.get_ylabel() for ax in axes] == [f"latent {k}" for k in range(2, 8)]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b", "d"]
    _, axes = plot_latent_paths(posterior, trial="two", names=list("stuvwxyz"), latents=[0])
    assert axes[0].get_ylabel() == "s"
    np.testing.assert_allclose(axes[0].lines[0].get_ydata(), 100.0)


def test_given_axes_are_used(posterior):
    grid = Figure().subplots(2, 1)
    figure, axes = plot_latent_paths(posterior, grid, latents=[0, 1])
    assert figure is grid[0].figure
    assert axes.tolist() == grid.tolist()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"level": 1.0}, "level: it must lie between 0 and 1, and it is 1"),
        ({"latents": [8]}, "latents: there is no 8; there are 0 to 7"),
        ({"latents": []}, "latents: none is named"),
        ({"individuals": ["q"]}, "individuals: there is no 'q'; there are a, b, c, d"),
        ({"trial": "q"}, "trial: there is no 'q'; there are one, two"),
        ({"names": ["x"]}, "names: 8 are needed, one a latent, and 1 are given"),
    ],
)
def test_mistakes_are_told(posterior, options, sentence):
    with pytest.raises(InputError, match=sentence):
        plot_latent_paths(posterior, **options)


def test_of_nobody_nothing_is_drawn(posterior):
    with pytest.raises(InputError, match="in trial one nobody is observed"):
        plot_latent_paths(posterior.isel(individual=[2]))
