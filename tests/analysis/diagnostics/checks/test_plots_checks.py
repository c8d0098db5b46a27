"""Figures of checks show what was planted."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from swarmssm.analysis.diagnostics.checks import check, one_step_pit
from swarmssm.analysis.plots.checks import (
    plot_check_overview,
    plot_order_parameters,
    plot_pit,
    plot_statistic,
    plot_statistics,
)
from swarmssm.errors import InputError
from swarmssm.metrics.arena import Arena


@pytest.fixture(scope="module")
def checked(flock):
    return check(*flock, draws=19, walls=Arena.box([-9, -9], [9, 9])).data


def test_the_overview_has_a_row_for_each_statistic_the_farthest_first(checked):
    figure, ax = plot_check_overview(checked)
    titles = [label.get_text() for label in ax.get_yticklabels()]
    assert sorted(titles) == sorted(checked["title"].values)
    far = checked["title"].values[np.abs(checked["place"].values).argmax()]
    assert titles[0] == far
    said = [text.get_text() for text in ax.texts]
    assert sum("p = " in text for text in said) == len(titles)
    figure.canvas.draw()


def test_a_dot_far_outside_becomes_an_arrow(checked):
    far = checked.copy(deep=True)
    far["place"][0] = 1e9
    _, ax = plot_check_overview(far)
    marks = [line.get_marker() for line in ax.lines if len(line.get_xdata()) == 1]
    assert marks.count(">") == 1
    assert ax.get_xlim()[1] < 10


def test_a_number_is_a_line_in_the_histogram(checked):
    _, ax = plot_statistic(checked, "amd")
    assert sum(patch.get_height() for patch in ax.patches) == 19
    assert ax.lines[0].get_xdata()[0] == float(checked["amd_observed"])
    assert "p = " in ax.get_title()


def test_a_curve_has_its_band(checked):
    _, ax = plot_statistic(checked, "heading_autocorrelation")
    np.testing.assert_array_equal(
        ax.lines[-1].get_ydata(), checked["heading_autocorrelation_observed"]
    )
    assert len(ax.collections) == 1
    assert ax.get_xlabel() == "time apart (s)"
    _, ax = plot_statistic(checked, "displacement")
    assert ax.get_yscale() == "log"


def test_states_have_their_names_and_maps_their_sides(checked):
    _, ax = plot_statistic(checked, "states")
    assert next(tick.get_text() for tick in ax.get_xticklabels()) == "swarm"
    _, ax = plot_statistic(checked, "neighbor_position")
    assert ax.xaxis_inverted()  # left is on the left


def test_all_on_one_sheet(checked):
    figure, grid = plot_statistics(checked)
    assert grid.shape == (5, 4)
    figure.canvas.draw()
    given = plt.figure(layout="constrained")
    axes = given.subplots(4, 5)
    assert plot_statistics(checked, axes)[0] is given
    plt.close(given)


def test_order_parameters_over_time(checked):
    _, axes = plot_order_parameters(checked)
    assert len(axes) == 4
    own = checked["series_observed"].sel(series="polarization", run=0)
    np.testing.assert_array_equal(axes[0].lines[-1].get_ydata(), own)


def test_pits_with_their_band(flock):
    found = one_step_pit(*flock, draws=10, origins=10).data
    figure, ax = plot_pit(found)
    assert next(text.get_text() for text in ax.get_legend().get_texts()) == "95 % band, whole line"
    figure.canvas.draw()


def test_what_is_not_there_is_refused(checked):
    with pytest.raises(InputError, match="'speeds' is none of the checked"):
        plot_statistic(checked, "speeds")
    with pytest.raises(InputError, match="run: there are 1"):
        plot_order_parameters(checked, 3)
