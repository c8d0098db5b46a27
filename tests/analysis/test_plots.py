"""Figures draw the numbers they are given, where they are told to."""

import numpy as np
import pytest
import xarray as xr
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from swarmssm.analysis import plots
from swarmssm.errors import InputError


def lines_of(ax):
    return {line.get_label(): np.asarray(line.get_xydata(), float) for line in ax.lines}


def segments_of(ax):
    (lines,) = (c for c in ax.collections if isinstance(c, LineCollection))
    return {tuple(np.ravel(segment)) for segment in lines.get_segments()}


def test_paths_are_drawn_as_given(planted):
    true = planted().imitation["true"]
    figure, ax = plots.plot_trajectories(true, attributes={"unit": "cm"}, title="school")
    assert isinstance(figure, Figure)
    assert ax.figure is figure
    paths = [np.asarray(line.get_xydata()) for line in ax.lines]
    np.testing.assert_array_equal(np.stack(paths, axis=1), true)
    (ends,) = (c for c in ax.collections if isinstance(c, PathCollection))
    np.testing.assert_array_equal(ends.get_offsets(), true.isel(time=-1))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (cm)", "y (cm)")
    assert ax.get_title() == "school"
    assert ax.get_aspect() == 1.0


def test_a_path_ends_where_the_individual_was_last_seen(planted):
    true = planted().imitation["true"].copy(deep=True)
    true[3:, 0] = np.nan
    true[:, 1] = np.nan
    _, ax = plots.plot_trajectories(true)
    (ends,) = (c for c in ax.collections if isinstance(c, PathCollection))
    np.testing.assert_array_equal(ends.get_offsets()[0], true[2, 0])
    assert len(ends.get_offsets()) == 3
    assert ax.get_xlabel() == "x"


def test_given_axes_are_used(planted):
    figure = Figure()
    ax = figure.add_subplot()
    evaluation = planted()
    for drawn in (
        plots.plot_trajectories(evaluation.imitation["true"], ax),
        plots.plot_edge_accuracy(evaluation.edges, ax),
        plots.plot_collective(evaluation.collective, ax),
        plots.plot_horizon_errors(evaluation.scores, ax),
    ):
        assert drawn == (figure, ax)
    axes = figure.subplots(1, 3)
    assert plots.plot_training(evaluation.history, axes)[1].tolist() == axes.tolist()
    with pytest.raises(InputError, match="axes: 3 are needed, and 2 are given"):
        plots.plot_training(evaluation.history, axes[:2])


def test_imitations_are_drawn_to_the_same_limits(planted):
    _, axes = plots.plot_imitation(planted().imitation)
    assert axes.shape == (3,)
    assert [ax.get_title() for ax in axes] == [
        "true",
        "imitated, one step at a time",
        "imitated, running freely",
    ]
    assert len({(ax.get_xlim(), ax.get_ylim()) for ax in axes}) == 1
    # The one-step imitation is half a unit higher.
    first = axes[1].lines[0].get_ydata()
    assert np.isnan(first[0])
    np.testing.assert_allclose(first[1:], 0.5)
    low, high = axes[0].get_xlim()
    assert low < 0
    assert high > 6


def test_snapshots_show_places_and_headings(planted):
    imitation = planted().imitation
    _, axes = plots.plot_snapshots(imitation, count=3)
    assert axes.shape == (2, 3)
    assert [ax.get_title() for ax in axes[0]] == ["true, 0 s", "true, 0.2 s", "true, 0.5 s"]
    (dots,) = (c for c in axes[0, 2].collections if isinstance(c, PathCollection))
    np.testing.assert_array_equal(dots.get_offsets(), imitation["true"].isel(time=-1))
    (arrows,) = (c for c in axes[0, 2].collections if isinstance(c, Quiver))
    np.testing.assert_allclose(arrows.U, 1.0)
    np.testing.assert_allclose(arrows.V, 0.0)


def test_snapshots_leave_out_who_is_unknown_and_draw_no_arrow_for_who_rests(planted):
    imitation = planted().imitation.copy(deep=True)
    imitation["true"][:, 0] = np.nan
    imitation["true_velocity"][:, 1] = 0.0
    imitation["true_velocity"][:, 2] = np.nan
    _, axes = plots.plot_snapshots(imitation, count=2)
    (dots,) = (c for c in axes[0, 0].collections if isinstance(c, PathCollection))
    assert len(dots.get_offsets()) == 3
    (arrows,) = (c for c in axes[0, 0].collections if isinstance(c, Quiver))
    assert (arrows.U.tolist(), arrows.V.tolist()) == ([1.0], [0.0])
    np.testing.assert_array_equal(arrows.get_offsets(), imitation["true"][0, [3]])
    imitation["true_velocity"][:] = 0.0
    _, axes = plots.plot_snapshots(imitation, count=2)
    assert not any(isinstance(c, Quiver) for c in axes[0, 0].collections)


def test_one_frame_is_one_snapshot(planted):
    _, axes = plots.plot_snapshots(planted().imitation.isel(time=[0]))
    assert axes.shape == (2, 1)


def test_graphs_are_drawn_edge_by_edge(planted):
    graphs = planted().graphs
    _, axes = plots.plot_graphs(graphs)
    assert axes.shape == (2, 2)
    # A ring of four edges, all mutual; the prediction lacks one direction of one of them.
    corners = graphs["position"][0].to_numpy()
    ring = {(0, 1), (0, 3), (1, 2), (2, 3)}
    assert segments_of(axes[0, 0]) == {(*corners[i], *corners[j]) for i, j in ring}
    assert segments_of(axes[1, 0]) == {(*corners[i], *corners[j]) for i, j in ring - {(0, 1)}}
    (arrow,) = (c for c in axes[1, 0].collections if isinstance(c, Quiver))
    np.testing.assert_allclose(arrow.get_offsets(), [[1.0, 0.0]])
    np.testing.assert_allclose((arrow.U, arrow.V), [[-1.0], [0.0]])
    assert not any(isinstance(c, Quiver) for c in axes[0, 0].collections)
    assert len(segments_of(plots.plot_graphs(graphs, threshold=0.1)[1][1, 0])) == 6


def test_no_edge_is_drawn_to_who_is_unknown(planted):
    graphs = planted().graphs.copy(deep=True)
    graphs["position"][:, 0] = np.nan
    graphs["probability"][:] = np.nan
    _, axes = plots.plot_graphs(graphs)
    assert len(segments_of(axes[0, 0])) == 2
    assert len(segments_of(axes[1, 0])) == 0


def test_edge_accuracy_is_the_mean_over_trials_that_are_known(planted):
    edges = planted(accuracy=(0.9, 0.8, 0.7, 0.6)).edges
    other = edges.copy(deep=True).assign_coords(trial=["1"])
    other["accuracy"][:] -= 0.2
    other["accuracy"][0, 0, 3:] = np.nan
    both = edges.combine_first(other)
    both["accuracy"][:, :, 4] = np.nan
    _, ax = plots.plot_edge_accuracy(both)
    lines = lines_of(ax)
    np.testing.assert_allclose(
        lines["graph-vae"][:, 1], [0.8, 0.8, 0.8, 0.9, np.nan], equal_nan=True
    )
    np.testing.assert_allclose(lines["graph-vae"][:, 0], np.arange(5) * 0.1)
    np.testing.assert_allclose(lines["no edge at all"][:4, 1], 0.5)
    assert plots.plot_edge_accuracy(edges, score="auc")[1].get_ylabel() == "AUC"


def test_cohesion_is_drawn_with_bands_for_truth_and_model(planted):
    collective = planted(amd_mean=(2.0, 3.0, 400.0)).collective
    collective["amd"][1, 2] = np.inf
    _, ax = plots.plot_collective(collective, score="amd", unit="cm")
    lines = lines_of(ax)
    assert list(lines) == ["truth", "graph-vae", "stay put", "constant velocity"]
    np.testing.assert_allclose(lines["graph-vae"][:, 1], [2, 2, np.nan, 2, 2], equal_nan=True)
    np.testing.assert_allclose(lines["stay put"][:, 1], 3.0)
    assert sum(isinstance(c, PolyCollection) for c in ax.collections) == 2
    assert (ax.get_ylabel(), ax.get_xlabel()) == ("AMD (cm)", "time since the start of the run (s)")
    # The axis is made for truth and model: a baseline that runs away does not flatten them.
    assert ax.get_ylim() == (0.0, pytest.approx(1.6 * 2.0))
    other = plots.plot_collective(collective, score="avd", unit="cm")[1]
    assert other.get_ylabel() == "AVD (cm/s)"
    assert plots.plot_collective(collective, score="avd")[1].get_ylabel() == "AVD"


def test_errors_are_drawn_over_the_steps_ahead(planted):
    rising = np.linspace(0.0, 1.9, 20)
    scores = planted(squared_error=(rising, 0.5, np.inf)).scores
    _, ax = plots.plot_horizon_errors(scores, score="squared_error")
    lines = lines_of(ax)
    np.testing.assert_allclose(lines["graph-vae"][1:, 1], rising[1:])
    # What has no logarithm is a gap.
    assert np.isnan(lines["graph-vae"][0, 1])
    assert np.isnan(lines["constant velocity"][:, 1]).all()
    assert ax.get_yscale() == "log"
    np.testing.assert_array_equal(lines["graph-vae"][:, 0], np.arange(1, 21))


def test_training_is_drawn_over_epochs(planted):
    history = planted().history
    _, axes = plots.plot_training(history)
    assert axes.shape == (3,)
    lines = lines_of(axes[0])
    np.testing.assert_array_equal(lines["training"], [[1, 4], [2, 2], [3, 1]])
    np.testing.assert_array_equal(lines["validation"], [[1, 4], [2, 1], [3, 3]])
    assert [ax.get_yscale() for ax in axes] == ["log", "log", "log"]
    below = history.copy(deep=True)
    below["loss"][:] = [4.0, 0.0, -3.0]
    below["validation_loss"][:] = np.nan
    _, axes = plots.plot_training(below)
    assert axes[0].get_yscale() == "symlog"
    assert list(lines_of(axes[0])) == ["training"]


def test_without_errors_of_one_step_there_is_the_loss_alone():
    epochs = np.arange(1.0, 41.0)
    loss = 5.0 - 0.2 * epochs
    loss[[9, 25]] = 1e8
    scored = np.full(40, np.nan)
    scored[-1] = -2.5
    history = xr.Dataset(
        {"loss": ("epoch", loss), "validation_loss": ("epoch", scored)}, {"epoch": epochs}
    )
    _, axes = plots.plot_training(history)
    assert axes.shape == (1,)
    lines = {line.get_label(): line for line in axes[0].lines}
    # One point makes no line: it is marked.
    assert lines["validation"].get_marker() == "o"
    assert lines["validation"].get_xydata().tolist() == [[40.0, -2.5]]
    # Two spikes leave the axis, which ends a little above the first loss.
    bottom, top = axes[0].get_ylim()
    assert 4.8 < top < 6.0
    assert -4.0 < bottom < -3.0
    assert axes[0].get_yscale() == "linear"


def test_runs_from_random_starts_have_axes_of_their_own(planted):
    runs = planted().random_starts
    _, axes = plots.plot_random_starts(runs)
    assert axes.shape == (2,)
    crosses = [line for line in axes[0].lines if line.get_marker() == "x"]
    np.testing.assert_array_equal(crosses[0].get_xydata(), runs["position"][0, 0])


def test_a_unit_is_text_and_no_formula(planted):
    figure, ax = plots.plot_trajectories(
        planted().imitation["true"], attributes={"unit": "$\\frac"}
    )
    figure.canvas.draw()  # text that is taken for a broken formula raises here
    assert "($\\frac)" in ax.get_xlabel()
    figure, ax = plots.plot_collective(planted().collective, unit="$_")
    figure.canvas.draw()
    assert "($_)" in ax.get_ylabel()


def test_each_method_has_one_colour_in_all_figures(planted):
    evaluation = planted(floor=0.1)
    drawn = (
        plots.plot_edge_accuracy(evaluation.edges)[1],
        plots.plot_collective(evaluation.collective)[1],
        plots.plot_horizon_errors(evaluation.scores)[1],
    )
    colours = [
        {line.get_label(): line.get_color() for line in ax.lines if isinstance(ax, Axes)}
        for ax in drawn
    ]
    assert colours[0]["graph-vae"] == colours[1]["graph-vae"] == colours[2]["graph-vae"]
    assert colours[1]["constant velocity"] == colours[2]["constant velocity"]
    assert len(set(colours[1].values())) == len(colours[1])


def test_drawing_leaves_pyplot_alone(planted):
    plots.plot_imitation(planted().imitation)
    plots.plot_collective(planted().collective)
    assert pyplot.get_fignums() == []
