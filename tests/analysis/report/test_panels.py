"""Figures in parts that a narrow screen puts below each other."""

import numpy as np
from matplotlib.colors import to_hex

from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.panels import (
    as_panels,
    kernel_figures,
    map_figure,
    modulation_varies,
)


def test_each_kernel_has_a_figure_with_the_truth(flock):
    with report_style():
        figures = kernel_figures(flock.kernels)
        text = str(as_panels(figures, "k", "Kernels."))
    assert [len(figure.axes) for figure in figures] == [1, 1]
    for figure, name in zip(figures, ("net", "alignment"), strict=True):
        drawn = [line.get_ydata() for line in figure.axes[0].lines if line.get_label() == "truth"]
        np.testing.assert_array_equal(drawn[0], flock.kernels[f"truth_{name}"])
    assert text.startswith('<div class="panels">')
    assert "Kernels. Panel 1 of 2: force of a neighbour" in text
    assert 'id="k-p1-' in text
    assert 'id="k-p2-' in text


def test_the_direction_is_shown_where_it_counts(flock, shoal):
    assert modulation_varies(shoal.kernels)
    plain = shoal.kernels.assign(modulation=0 * shoal.kernels["modulation"] + 1.0)
    assert not modulation_varies(plain)
    assert not modulation_varies(flock.kernels.drop_vars("modulation", errors="ignore"))


def test_maps_say_whose_they_are(flock):
    with report_style():
        figure = map_figure(flock.force_maps)
    titles = [ax.get_title() for ax in figure.axes[:4]]
    assert titles == [
        "turning: model's map",
        "turning: raw map",
        "speeding: model's map",
        "speeding: raw map",
    ]
    assert [bool(ax.get_ylabel()) for ax in figure.axes[:4]] == [True, False, True, False]


def test_colours_of_the_page_are_left_to_it(flock):
    with report_style():
        text = str(as_panels([map_figure(flock.force_maps)], "m", "Maps."))
    assert to_hex("black") not in text
    assert text.startswith("<svg")
