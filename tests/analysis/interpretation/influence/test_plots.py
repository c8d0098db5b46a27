"""Look into the figures for the numbers they were given."""

import matplotlib.patches
import numpy as np
import pyro.distributions as dist
import pytest
import torch

from swarmssm.analysis.interpretation.influence.posterior import influence
from swarmssm.analysis.plots.influence import (
    plot_influence,
    plot_influence_matrix,
    plot_influence_network,
    plot_leadership,
)


@pytest.fixture
def found(make_fit, make_kernels, tracks):
    """The second counts e^2 times as much, the third nothing to speak of, all surely."""
    prior = dist.LogNormal(torch.tensor([0.0, 2.0, -9.0, 0.0]), 0.01).to_event(1)
    return influence(make_fit(tracks, make_kernels(influence=prior)), tracks, 3)


def test_an_arrow_for_each_pair_that_matters(found):
    """Three from each of those with influence, none from the third."""
    _, ax = plot_influence_network(found, strength="pair_weight")
    arrows = [p for p in ax.patches if isinstance(p, matplotlib.patches.FancyArrowPatch)]
    assert len(arrows) == 9
    widths = sorted(arrow.get_linewidth() for arrow in arrows)
    # e^-2 of the widest.
    np.testing.assert_allclose(widths[-3:], 4.0, rtol=0.1)
    np.testing.assert_allclose(widths[:6], 0.3 + 3.7 * np.exp(-2.0), rtol=0.1)
    assert [text.get_text() for text in ax.texts] == ["0", "1", "2", "3"]


def test_the_matrix_is_that_of_the_dataset(found):
    _, ax = plot_influence_matrix(found)
    shown = np.ma.filled(ax.images[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, found["influence"].sel(quantile=0.5))
    # A dot at each of the three whom the third does not move.
    columns = set(ax.lines[0].get_xdata())
    assert 2 in columns


def test_the_ranking_has_the_leader_on_top(found):
    _, ax = plot_leadership(found)
    assert [label.get_text() for label in ax.get_yticklabels()][-1] == "1"
    assert "weight" in ax.get_xlabel()
    middle = ax.lines[0].get_xdata()
    np.testing.assert_allclose(middle, np.sort(found["weight"].median("sample")), rtol=1e-6)
    assert [text.get_text() for text in ax.texts] == ["100 %", "first"]
    _, ax = plot_leadership(found, by="outgoing")
    assert "cm/s²" in ax.get_xlabel()


def test_three_side_by_side(found):
    figure, axes = plot_influence(found)
    assert axes.shape == (3,)
    figure.draw_without_rendering()
