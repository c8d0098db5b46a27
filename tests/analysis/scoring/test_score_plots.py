"""Figures of a backtest draw the numbers that are in it."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from swarmssm.analysis.plots.scores import plot_forecast_coverage, plot_scores
from swarmssm.analysis.scoring import score_intervals, score_table
from swarmssm.errors import InputError


@pytest.mark.parametrize("score", ["log_score", "crps", "energy_score", "mse", "width"])
def test_each_model_is_a_line_of_its_means(scores, score):
    figure, ax = plot_scores(scores, score)
    table = score_table(scores, score)
    assert [line.get_label() for line in ax.lines] == scores["title"].values.tolist()
    for line, row in zip(ax.lines, table.to_numpy(), strict=True):
        np.testing.assert_allclose(line.get_ydata(), row)
        np.testing.assert_allclose(line.get_xdata(), [0.1, 0.3, 0.5])
    assert len({line.get_color() for line in ax.lines}) == 4
    figure.canvas.draw()


def test_axes_are_labelled_and_given_ones_are_used(planted):
    figure = Figure()
    ax = figure.add_subplot()
    same, again = plot_scores(planted({"a": 1.0, "b": 9.0, "stay-put": 80.0}), "crps", ax)
    assert (same, again) == (figure, ax)
    assert ax.get_xlabel() == "time ahead (s)"
    assert ax.get_ylabel() == "CRPS of positions (cm)\nlower is better"
    assert ax.get_yscale() == "log"
    assert len({line.get_color() for line in ax.lines}) == 3
    figure.canvas.draw()


def test_coverage_stands_beside_what_is_promised(planted):
    figure, ax = plot_forecast_coverage(planted({"a": np.ones((40, 1))}, coverage=0.7), 0.5)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), 0.7)
    np.testing.assert_allclose(ax.lines[-1].get_ydata(), 0.5)
    figure.canvas.draw()
    with pytest.raises(InputError, match=r"level: 0\.8 was not scored"):
        plot_forecast_coverage(planted({"a": 1.0}), 0.8)


def test_what_is_infinite_is_left_out(planted):
    broken = np.ones((40, 2))
    broken[3, 1] = np.inf
    figure, ax = plot_scores(planted({"a": broken, "b": 2.0}), "crps")
    assert ax.lines[0].get_ydata()[0] == 1.0
    assert np.isnan(ax.lines[0].get_ydata()[1])
    figure.canvas.draw()


def test_intervals_of_a_mean_are_about_it(planted):
    noise = np.random.default_rng(0).normal(size=(300, 1))
    found = score_intervals(planted({"a": 5.0 + noise}, every=1000), "crps")
    low, middle, high = found.isel(model=0, horizon=0).to_numpy()
    assert middle == pytest.approx(5.0 + noise.mean())
    expected = 1.645 * noise.std() / np.sqrt(300)
    assert high - middle == pytest.approx(expected, rel=0.35)
    assert middle - low == pytest.approx(expected, rel=0.35)
