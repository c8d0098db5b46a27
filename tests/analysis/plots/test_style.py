"""What all figures have in common."""

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from swarmssm.analysis.plots import plot_tracks, plot_trajectories
from swarmssm.analysis.plots.style import millimetres, new_axes, new_grid, paint_ground, save_figure
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks


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


@pytest.mark.parametrize(
    ("ending", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")]
)
def test_a_figure_is_saved_at_a_width(tmp_path, ending, start):
    figure, ax = new_axes(None, (6.0, 3.0))
    ax.set_xlabel("distance (cm)")
    path = tmp_path / f"figure.{ending}"
    save_figure(figure, path, width="85mm")
    content = path.read_bytes()
    assert content.startswith(start)
    np.testing.assert_allclose(figure.get_size_inches(), [85 / 25.4, 42.5 / 25.4])
    if ending == "pdf":
        assert b"/Type3" not in content
        assert b"/TrueType" in content or b"/CIDFontType2" in content
    if ending == "svg":
        assert b"distance (cm)</text>" in content
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("width", ["85", 85, "85 mm", "8.5cm", "3.3464567in"])
def test_widths(width):
    assert millimetres(width) == pytest.approx(85.0)


def test_letters_shrink_with_the_figure(tmp_path):
    """Two panels of 9.6 inches fit into a column, where letters of 10 points would not."""
    figure, axes = new_grid(None, 1, 2, (9.6, 3.9))
    for ax in axes[0]:
        ax.plot([0, 1], [0, 300])
        ax.set_xlabel("distance (cm)", fontsize=10)
        ax.set_ylabel("force (cm/s²)", fontsize=10)
    for _ in range(2):
        save_figure(figure, tmp_path / "figure.pdf", "120mm")
        ratio = 120 / 25.4 / 9.6
        assert axes[0, 0].xaxis.label.get_fontsize() == pytest.approx(max(5, 10 * ratio))
        assert axes[0, 1].yaxis.get_ticklabels()[0].get_fontsize() < 6
    with pytest.raises(InputError, match=r"tiny\.pdf: the figure has no room for its labels"):
        save_figure(figure, tmp_path / "tiny.pdf", "20mm")
    assert not (tmp_path / "tiny.pdf").exists()


def test_what_is_no_figure_is_named(tmp_path):
    figure, _ = new_axes(None)
    with pytest.raises(InputError, match=r"figure\.jpg: figures are written as pdf, svg, png"):
        save_figure(figure, tmp_path / "figure.jpg")
    for width in ("wide", "nan", -5, "3mm"):
        with pytest.raises(InputError, match="width"):
            save_figure(figure, tmp_path / "figure.pdf", width)


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_space_is_drawn_as_the_recording_shows_it(y_axis):
    position = np.random.default_rng(0).normal(size=(20, 3, 2)).cumsum(0)
    tracks = make_tracks(position, fps=10, unit="px", attrs={"y_axis": y_axis})
    _, paths = plot_trajectories(tracks)
    _, moment = plot_tracks(tracks)
    for ax in (paths, moment):
        bottom, top = ax.get_ylim()
        assert bool(bottom > top) is (y_axis == "down")
        assert ax.get_ylabel() == "y (px)"


def test_a_notebook_shows_what_is_drawn(monkeypatch):
    """The cell shows what pyplot knows of; a report's figures are not among them."""
    import matplotlib.pyplot as plt

    from swarmssm.analysis.plots.style import new_axes
    from swarmssm.analysis.report.embed import report_style

    before = set(plt.get_fignums())
    monkeypatch.setattr(plt, "isinteractive", lambda: bool(plt.rcParams["interactive"]))
    with plt.rc_context({"interactive": True}):
        new_axes(None)
        assert set(plt.get_fignums()) == before
        monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
        with report_style():
            new_axes(None)
        assert set(plt.get_fignums()) == before
        figure, _ = new_axes(None)
        assert plt.fignum_exists(figure.number)
    plt.close(figure)
