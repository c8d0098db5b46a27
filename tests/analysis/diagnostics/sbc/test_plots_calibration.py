"""Figures of calibration and recovery: what is drawn is what the dataset says."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from swarmssm.analysis.diagnostics.sbc.ranks import calibration_of_ranks
from swarmssm.analysis.plots.calibration import (
    plot_calibration,
    plot_coverage,
    plot_ecdf_difference,
    plot_rank_histograms,
)
from swarmssm.analysis.plots.recovery import plot_recovery
from swarmssm.errors import InputError

NOISE = "noise (outside)"


@pytest.fixture(scope="module")
def ranks():
    rng = np.random.default_rng(0)
    good = {f"transition.gain_{i}": rng.integers(0, 100, 80) for i in range(3)}
    low = np.full(80, 3)
    return calibration_of_ranks({**good, "emission.noise": low}, 99)


def test_a_histogram_for_each_quantity(ranks):
    figure, grid = plot_rank_histograms(ranks)
    assert grid.shape == (2, 3)
    heights = [bar.get_height() for bar in grid[1, 0].patches[:20]]
    assert heights == ranks["histogram"].values[3].tolist()
    assert grid[1, 0].get_title() == NOISE
    assert grid[0, 0].get_title() == "gain_0"
    assert not grid[1, 2].axison
    figure.canvas.draw()


def test_the_line_is_the_difference_from_uniform(ranks):
    figure, ax = plot_ecdf_difference(ranks)
    line = next(one for one in ax.lines if one.get_label() == NOISE)
    # All 80 ranks are 3: nobody is below 3 or less, all are below 4 and more.
    assert line.get_ydata()[2] == pytest.approx(-0.03)
    assert line.get_ydata()[3] == pytest.approx(1 - 0.04)
    assert "95 % band" in ax.get_legend().get_texts()[0].get_text()
    figure.canvas.draw()


def test_coverage_has_a_row_for_each_quantity(ranks):
    figure, ax = plot_coverage(ranks)
    assert [text.get_text() for text in ax.get_yticklabels()][-1] == "noise"
    assert len(ax.containers) == 4
    figure.canvas.draw()


def test_all_on_one_sheet(ranks):
    figure, axes = plot_calibration(ranks)
    assert axes.shape == (4 + 2,)
    assert [ax.get_title() for ax in axes[:4]] == ["gain_0", "gain_1", "gain_2", NOISE]
    assert axes[4].get_ylabel() == "share of data sets below, minus uniform"
    assert axes[5].get_xlabel() == "share of intervals that hold the truth"
    # Two of the six places above are left over.
    assert [ax.axison for ax in figure.get_axes()].count(False) == 2
    figure.canvas.draw()


def test_all_into_given_axes(ranks):
    given = Figure().subplots(2, 3)
    figure, axes = plot_calibration(ranks, given)
    assert figure is given[0, 0].figure
    assert axes.tolist() == given.ravel().tolist()
    assert given[1, 0].get_title() == NOISE
    with pytest.raises(InputError, match="6 are needed, and 3 are given"):
        plot_calibration(ranks, given[0])


def test_recovery_is_drawn_for_each_factor(tmp_path):
    import xarray as xr

    found = xr.Dataset(
        {
            "error": (("design", "parameter"), [[0.2, 0.1], [0.1, 0.0], [0.4, 0.3]]),
            "width": (("design", "parameter"), np.full((3, 2), 0.5)),
        },
        {
            "parameter": ["transition.cohesion_gain", "emission.noise"],
            "factor": ("design", ["base", "frames", "noise"]),
            "frames": ("design", [100, 200, 100]),
            "noise": ("design", [0.03, 0.03, 0.1]),
        },
        {"tolerance": 0.1},
    )
    figure, grid = plot_recovery(found)
    assert grid.shape == (1, 2)
    line = grid[0, 0].lines[0]
    assert line.get_xdata().tolist() == [100, 200]
    assert line.get_ydata().tolist() == [0.2, 0.1]
    assert grid[0, 1].lines[0].get_ydata().tolist() == [0.2, 0.4]
    assert grid[0, 0].lines[-1].get_ydata() == [0.1, 0.1]
    figure.canvas.draw()
    with pytest.raises(InputError, match="nothing to draw"):
        plot_recovery(found.isel(design=[0]))
