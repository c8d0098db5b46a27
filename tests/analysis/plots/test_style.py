"""What all figures have in common."""

import io

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

from swarmssm.analysis.plots.style import paint_ground


def test_the_ground_stays_in_a_transparent_figure():
    figure = Figure(figsize=(1.0, 1.0), dpi=50)
    ax = figure.add_axes((0.2, 0.2, 0.6, 0.6))
    paint_ground(ax, "#ff0000")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", transparent=True)
    stream.seek(0)
    pixels = imread(stream, format="png")
    np.testing.assert_array_equal(pixels[25, 25], [1.0, 0.0, 0.0, 1.0])
    # Outside the axes there is nothing.
    assert pixels[2, 2, 3] == 0.0
    assert ax.get_xlim() == (0.0, 1.0)
