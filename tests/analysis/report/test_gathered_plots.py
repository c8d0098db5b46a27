"""Pictures of several sets: one axis for shares, one colour for a model everywhere."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from swarmssm.analysis.plots.gathered import plot_gathered_shares, plot_log_scores
from swarmssm.errors import InputError


def test_shares_stand_below_each_other_on_one_axis(flock):
    wide = flock.forces.copy(deep=True)
    wide["share"] = 2.0 * wide["share"]
    figure, axes = plot_gathered_shares({"a $x$": flock.forces, "b": wide})
    assert [ax.get_title(loc="left") for ax in axes] == ["a $x$", "b"]
    assert axes[0].get_xlim() == axes[1].get_xlim()
    for ax, times in zip(axes, (1.0, 2.0), strict=True):
        drawn = [bar.get_width() for bar in ax.patches]
        expected = 100 * times * flock.forces["share"].sel(quantile=0.5).to_numpy()
        np.testing.assert_allclose(drawn, expected, rtol=1e-6)
    assert axes[0].get_figure() is figure
    with pytest.raises(InputError, match="axes: 2 are needed"):
        plot_gathered_shares({"a": flock.forces, "b": wide}, Figure().subplots(1, 1, squeeze=False))


def test_log_scores_are_means_with_the_names_of_people(scores):
    found = scores(boids=(-1.0, -1.0, -1.0), constant_velocity=(1.0, 0.0, -1.0))
    _, ax = plot_log_scores(found)
    drawn = {str(line.get_label()): line.get_ydata() for line in ax.lines}
    assert list(drawn) == ["graph-vae", "boids", "constant velocity"]
    np.testing.assert_allclose(drawn["graph-vae"], [-30.5, -31.5, -34.5])
    np.testing.assert_allclose(drawn["constant velocity"], [-29.5, -31.5, -35.5])
    assert [text.get_text() for text in ax.get_xticklabels()] == ["1", "2", "5"]


def test_a_model_has_one_colour_in_all_sets(scores):
    both = scores(boids=(-1.0, -1.0, -1.0))
    models = ["boids", "graph-vae"]
    one = plot_log_scores(both, models=models)[1].lines
    other = plot_log_scores(both.sel(model=["boids"]), models=models)[1].lines
    assert one[1].get_color() == other[0].get_color() != one[0].get_color()
    assert one[1].get_marker() == other[0].get_marker() != one[0].get_marker()


def test_a_score_that_is_not_finite_is_a_gap(scores):
    found = scores(boids=(0.0, 0.0, 0.0))
    found["log_score"].loc[{"model": "boids", "horizon": 5}] = -np.inf
    _, ax = plot_log_scores(found)
    assert np.isnan(ax.lines[1].get_ydata()).tolist() == [False, False, True]
    assert np.isfinite(ax.get_ylim()).all()
    found["log_score"][:] = np.nan
    plot_log_scores(found)


def test_a_curve_far_below_leaves_the_axes(scores):
    found = scores(boids=(-1e6, -1e6, -1e6), constant_velocity=(1.0, 0.0, -1.0))
    bottom, top = plot_log_scores(found)[1].get_ylim()
    assert bottom > -1e3
    assert bottom < -35.5
    assert top > -29.5
