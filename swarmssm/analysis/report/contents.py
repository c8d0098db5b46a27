"""What a report shows: one list of figures and tables, each with a fixed caption."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure as Drawing

from swarmssm.analysis import plots
from swarmssm.analysis.diagnostics.checks.result import PredictiveCheck
from swarmssm.analysis.plots import forces as force_plots
from swarmssm.analysis.plots import influence as influence_plots
from swarmssm.analysis.plots import latents as latent_plots
from swarmssm.analysis.plots.checks import (
    plot_check_overview,
    plot_order_parameters,
    plot_pit,
    plot_statistic,
)
from swarmssm.analysis.plots.inferred_edges import plot_edge_probabilities
from swarmssm.analysis.plots.kernels import plot_force_maps, plot_kernels, plot_modulation
from swarmssm.analysis.plots.model_graph import plot_model
from swarmssm.analysis.plots.presence import plot_presence
from swarmssm.analysis.plots.scores import plot_forecast_coverage, plot_scores
from swarmssm.analysis.report import metadata
from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.page import Block, Prose, Section, Table, figure
from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.thesis import FOOTNOTE
from swarmssm.analysis.scoring.thesis_scores import edge_table, horizon_table, scores_table

__all__ = [
    "CONTENTS",
    "HEADINGS",
    "Content",
    "glossary",
    "kernel_figures",
    "mean_scores",
    "sections",
]

#: The folded parts of a report, in their order.
HEADINGS = {
    "forces": "Forces",
    "kernels": "Kernels: what a neighbour does at each distance",
    "force_maps": "Force maps: turning and speeding by where a neighbour is",
    "latents": "What the latents carry",
    "influence": "Who influences whom",
    "edges": "Inferred edges",
    "forecasts": "Forecasts, free runs and graphs",
    "comparison": "Forecast scores beside baselines and other fits",
    "checks": "Posterior predictive checks",
    "model": "Model and parameters",
    "training": "Training",
    "data": "Data",
    "provenance": "Settings, versions and digests",
}
#: Frames of a curve over time that are drawn at most.
FRAMES = 1000
#: Statistics of a check that are drawn one by one at most, those with the smallest p first.
DRAWN = 9
PANEL, SIDE, MAPS = (4.4, 3.8), (4.6, 3.7), (6.4, 6.0)


@dataclass(frozen=True)
class Content:
    """A figure or a table of a report.

    Attributes
    ----------
    section
        Where it stands: a key of ``HEADINGS``.
    needs
        Name of the result that it is made from; without that result it is left out.
    title, caption
        What it shows and how to read it, true of any data. Of a table the caption alone.
    make
        From the result to a figure, several, the ``(figure, axes)`` of a plot, or a DataFrame;
        ``None`` where it does not apply.
    thesis
        Figures of the thesis that it reproduces.
    """

    section: str
    needs: str
    title: str
    caption: str
    make: Callable[[Any], Any]
    thesis: str = ""

    def block(self, results: Mapping[str, Any]) -> Block | None:
        """Make it from the results; ``None`` where it does not apply."""
        if results.get(self.needs) is None:
            return None
        made = self.make(results[self.needs])
        if made is None or (isinstance(made, Sequence) and not made):
            return None
        if isinstance(made, pd.DataFrame):
            printed = self.thesis and made.iloc[:, 0].str.contains("thesis").any()
            return Table(self.caption, made, FOOTNOTE if printed else "")
        if isinstance(made, tuple):
            made = made[0]
        return figure(self.title, self.caption, made, self.thesis)


def sections(results: Mapping[str, Any], only: Sequence[str] | None = None) -> list[Section]:
    """Return the folded parts that these results have something for.

    Parameters
    ----------
    results
        By the names that ``Content.needs`` asks for: ``fit``, ``tracks``, ``evaluation``,
        ``checks``, ``pit``, ``comparison``, the datasets of an analysis, and ``remarks``: what is
        to be read below the heading of a section, by its key.
    only
        Keys of ``HEADINGS``; absent, all.
    """
    remarks = results.get("remarks", {})
    found = []
    with report_style():
        for key, heading in HEADINGS.items():
            if only is not None and key not in only:
                continue
            made = (one.block(results) for one in CONTENTS if one.section == key)
            blocks = [block for block in made if block is not None]
            if blocks:
                found.append(Section(heading, [*remarks.get(key, ()), *blocks], folded=True))
    return found


def glossary() -> Section:
    """Return what the words of a report mean, folded."""
    text = resources.files("swarmssm.analysis.report").joinpath("glossary.html").read_text("utf-8")
    return Section("Glossary", [Prose(Markup(text))], folded=True)


def _edges_vary(evaluation: Evaluation) -> bool:
    """Return whether some pairs are linked and others not: else no graph is to be predicted."""
    density = evaluation.edges["density"].to_numpy()
    known = density[np.isfinite(density)]
    return not known.size or bool(known.min() < 1.0 and known.max() > 0.0)


def kernel_figures(found: xr.Dataset) -> list[Drawing]:
    """Draw the kernels of distance, each in a figure of its own, with the truth if it is known."""
    names = [str(name) for name in found if str(name).startswith("truth_")]
    curves = [name for name in names if "distance" in found[name].dims]
    truth = found[curves].rename({name: name.removeprefix("truth_") for name in curves})
    figures = _several(2, PANEL)
    axes = np.array([one.axes[0] for one in figures], dtype=object)
    plot_kernels(found, axes, truth=truth if curves else None)
    # A model without alignment has no picture of it.
    drawn = [one for one in figures if one.axes[0].get_visible()]
    for one in drawn:
        one.axes[0].legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.16),
            ncols=2,
            frameon=False,
            fontsize=8,
            columnspacing=1.0,
            handlelength=1.6,
        )
    return drawn


def _several(count: int, size: tuple[float, float]) -> list[Drawing]:
    """Return figures with axes that stand side by side, or below each other on a narrow screen."""
    figures = [Drawing(figsize=size, layout="constrained") for _ in range(count)]
    for one in figures:
        one.add_subplot()
    return figures


def _modulation(found: xr.Dataset) -> Drawing | None:
    """Draw how much a neighbour counts by its direction, unless all directions count alike."""
    if "modulation" not in found:
        return None
    if np.abs(found["modulation"].sel(quantile=0.5).to_numpy() - 1.0).max() <= 1e-6:
        return None
    (drawn,) = _several(1, PANEL)
    plot_modulation(found, drawn.axes[0])
    return drawn


def _maps(found: xr.Dataset) -> Drawing:
    """Draw force maps, model beside raw, small enough for a narrow screen."""
    drawn = Drawing(figsize=MAPS, layout="constrained")
    axes = drawn.subplots(2, found.sizes["source"], squeeze=False)
    plot_force_maps(found, axes)
    sources = [str(name) for name in found["source"].to_numpy()]
    for line, name in zip(axes, ("turning", "speeding"), strict=True):
        for ax, source in zip(line, sources, strict=True):
            ax.set_title(f"{name}: {source}", fontsize=10)
            ax.set_ylabel(ax.get_ylabel() if source == sources[0] else "", parse_math=False)
    return drawn


def _forces_over_time(found: xr.Dataset) -> Drawing:
    """Draw the strength of forces in the first trial."""
    every = math.ceil(found.sizes["time"] / FRAMES)
    drawn = Drawing(figsize=(6.8, 3.8), layout="constrained")
    force_plots.plot_force_magnitudes(
        found.isel(trial=[0], time=slice(None, None, every)), drawn.add_subplot()
    )
    return drawn


def _arrows(found: xr.Dataset) -> Drawing:
    """Draw forces in the middle one of the frames with most individuals."""
    present = found["velocity"].isel(trial=0, draw=0).notnull().all("space").sum("individual")
    most = np.flatnonzero(present.to_numpy() == int(present.max()))
    drawn: Drawing = force_plots.plot_force_arrows(found, frame=int(most[len(most) // 2]))[0]
    return drawn


def _influence(plot: Callable[[xr.Dataset], Any]) -> Callable[[xr.Dataset], Any]:
    """Return a plot of influence, for those of whom any is known."""
    return lambda found: plot(found) if found["influence"].notnull().any() else None


def _training(evaluation: Evaluation) -> list[Drawing] | None:
    """Draw the loss, and the errors of one step where they are known."""
    history = evaluation.history
    if not history.sizes.get("epoch"):
        return None
    whole, axes = plots.plot_training(history)
    if len(axes) == 1:
        return [whole]
    figures = _several(len(axes), SIDE)
    plots.plot_training(history, np.array([one.axes[0] for one in figures]))
    return figures


def _errors_ahead(evaluation: Evaluation) -> list[Drawing]:
    """Draw MSE and MAE side by side, as the thesis does."""
    figures = _several(2, SIDE)
    for one, score in zip(figures, ("forecast_mse", "forecast_mae"), strict=True):
        plots.plot_horizon_errors(evaluation.scores, one.axes[0], score=score)
    return figures


def _collective(score: str) -> Callable[[Evaluation], Any]:
    return lambda found: plots.plot_collective(
        found.collective, score=score, unit=found.settings["unit"]
    )


def _of_graphs(make: Callable[[Evaluation], Any]) -> Callable[[Evaluation], Any]:
    """Return what is shown of graphs only where they vary."""
    return lambda found: make(found) if _edges_vary(found) else None


def _statistics_order(checked: xr.Dataset) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
    """Return the order of statistics, those of the smallest p first."""
    p_values = np.nan_to_num(checked["p_value"].to_numpy(), nan=2.0)
    far = -np.nan_to_num(np.abs(checked["place"].to_numpy()))
    return np.lexsort((far, p_values))


def _statistics(checked: xr.Dataset) -> list[Drawing]:
    """Draw the statistics in which recording and model differ most."""
    names = checked["statistic"].to_numpy()[_statistics_order(checked)]
    known = [name for name in names if np.isfinite(checked["p_value"].sel(statistic=name))]
    return [plot_statistic(checked, str(name))[0] for name in known[:DRAWN]]


def _verdicts(checked: xr.Dataset) -> pd.DataFrame:
    """Return a row for each statistic."""
    return PredictiveCheck(checked).summary()


def _order_parameters(checked: xr.Dataset) -> Any:
    known = bool(checked["series_observed"].notnull().any())
    return plot_order_parameters(checked) if known else None


def mean_scores(score: str) -> Callable[[xr.Dataset], pd.DataFrame | None]:
    """Return a function that gives the mean of a score, a row a model, a column a horizon."""

    def table(scores: xr.Dataset) -> pd.DataFrame | None:
        if score not in scores:
            return None
        means = score_table(scores, score).transpose("model", "horizon")
        steps = [f"{step} step{'s' * (step > 1)}" for step in means["horizon"].to_numpy().tolist()]
        titles = scores["title" if "title" in scores.coords else "model"].to_numpy()
        return pd.DataFrame(means.to_numpy(), pd.Index(titles, name="model"), steps)

    return table


def _rows(rows: Sequence[Mapping[str, str]]) -> pd.DataFrame | None:
    return pd.DataFrame(list(rows)) if rows else None


def _facts(pairs: Sequence[tuple[str, str]]) -> pd.DataFrame:
    """Return labels with their texts as a table without heads of columns."""
    return pd.DataFrame(list(pairs), columns=["", " "])


CONTENTS = [
    Content(
        "forces",
        "forces",
        "Share of each force",
        "Mean length of a force over the sum of the mean lengths of all, over all individuals and "
        "frames, with 90 % intervals over the draws. They hold if the terms of the model are the "
        "right ones.",
        force_plots.plot_force_shares,
    ),
    Content(
        "forces",
        "forces",
        "Forces over time",
        "Mean length over the group in the first trial, with 90 % bands over the draws: the "
        "uncertainty within the model, not whether it is the right one.",
        _forces_over_time,
    ),
    Content(
        "forces",
        "forces",
        "Forces in one frame",
        "Strong arrows are posterior means, faint ones single draws: where these point everywhere "
        "the direction of a force is unknown. Of three dimensions the first two are drawn.",
        _arrows,
    ),
    Content(
        "kernels",
        "kernels",
        "Kernels of distance",
        "What a neighbour at each distance does: positive is towards it, negative away. Bands are "
        "90 % intervals. The grey hill below is the density of distances between neighbours; where "
        "it is low, a curve follows from the prior and its form. A dotted line marks the preferred "
        "distance.",
        kernel_figures,
    ),
    Content(
        "kernels",
        "kernels",
        "Kernel of direction",
        "Factor by which a neighbour counts, by the direction in which it is seen; 0 degrees is "
        "straight ahead. The band is the 90 % interval.",
        _modulation,
    ),
    Content(
        "force_maps",
        "force_maps",
        "Force maps",
        "Mean turning and speeding of an individual (the triangle, heading up) by where another "
        "one is. Faint bins are within two standard errors of zero; grey ones have too few pairs. "
        "A map shows what goes together: other individuals and walls have a part in it.",
        _maps,
    ),
    Content(
        "latents",
        "latents",
        "How well each source predicts each force",
        "R² on blocks of time that the probe has not seen: 1 is perfect, 0 no better than the "
        "mean. Compare with an untrained network and with the observations.",
        latent_plots.plot_sources,
    ),
    Content(
        "latents",
        "latents",
        "Each latent by itself",
        "R² of each force predicted from one latent alone.",
        latent_plots.plot_latents,
    ),
    Content(
        "latents",
        "latents",
        "The latent space rotated towards the forces",
        "R² of each force along the axes of the rotated space.",
        lambda found: latent_plots.plot_rotated_axes(found) if "axis_r2" in found else None,
    ),
    Content(
        "influence",
        "influence",
        "Mean influence of each individual on another",
        "By how much the acceleration of another would differ without it, within the model, with "
        "90 % intervals. Where the rule is the same for all, this is a matter of place.",
        _influence(influence_plots.plot_leadership),
    ),
    Content(
        "influence",
        "influence",
        "Influence of each pair",
        "Arrows, and the same numbers as a matrix.",
        _influence(
            lambda found: [
                influence_plots.plot_influence_network(found)[0],
                influence_plots.plot_influence_matrix(found)[0],
            ]
        ),
    ),
    Content(
        "influence",
        "delays",
        "Who turns first",
        "Mean time by which an individual turns before the others, from directions alone, with 90 "
        "% intervals.",
        plots.plot_delays,
    ),
    Content(
        "edges",
        "edges",
        "Probability of each edge",
        "Posterior probability that one individual acts on another.",
        plot_edge_probabilities,
    ),
    Content(
        "forecasts",
        "evaluation",
        "",
        "One step ahead (scaled states), free runs, and the next graph",
        lambda found: _rows(scores_table(found, found.settings["thesis"])),
        "tables I, II",
    ),
    Content(
        "forecasts",
        "evaluation",
        "",
        "Mean squared error of scaled states",
        lambda found: _rows(horizon_table(found)),
    ),
    Content(
        "forecasts",
        "evaluation",
        "",
        "The next interaction graph, means over time",
        _of_graphs(lambda found: _rows(edge_table(found))),
    ),
    Content(
        "forecasts",
        "evaluation",
        "Error against steps ahead",
        "Errors of the expected future, divided by half the mean length of a true step, (4.1) to "
        "(4.3) of the thesis.",
        _errors_ahead,
        "4.11, 4.12",
    ),
    Content(
        "forecasts",
        "evaluation",
        "True and predicted paths",
        "Recorded paths, each frame predicted from the frame before, and a free run from the first "
        "frame.",
        lambda found: plots.plot_imitation(found.imitation),
        "4.1, 4.2",
    ),
    Content(
        "forecasts",
        "evaluation",
        "The group at several times",
        "Places and headings of the recording and of a free run from its first frame.",
        lambda found: plots.plot_snapshots(found.imitation),
        "4.3, 4.4",
    ),
    Content(
        "forecasts",
        "evaluation",
        "True and predicted graphs",
        "Edges of some frames, and those predicted from the frame before.",
        _of_graphs(lambda found: plots.plot_graphs(found.graphs)),
        "4.5",
    ),
    Content(
        "forecasts",
        "evaluation",
        "Accuracy of the next graph",
        "Share of all pairs predicted correctly, beside the same graph as before and always the "
        "more frequent value.",
        _of_graphs(lambda found: plots.plot_edge_accuracy(found.edges)),
        "4.6, 4.13",
    ),
    Content(
        "forecasts",
        "evaluation",
        "Cohesion of free runs",
        "Mean distance to the nearest neighbour, AMD (4.4). The band holds the middle 80 % of the "
        "free runs.",
        _collective("amd"),
        "4.7a, 4.8a",
    ),
    Content(
        "forecasts",
        "evaluation",
        "Alignment of free runs",
        "Mean difference of two velocities, AVD (4.5). The band holds the middle 80 % of the free "
        "runs.",
        _collective("avd"),
        "4.7b, 4.8b",
    ),
    Content(
        "forecasts",
        "evaluation",
        "Free runs from random starts",
        "Paths of groups that start at random places with random headings.",
        lambda found: plots.plot_random_starts(found.random_starts),
        "4.14",
    ),
    Content(
        "comparison",
        "scores",
        "Scores against time ahead",
        "Means over the same origins for all, with 90 % intervals of each mean by itself. Whether "
        "two models differ is told by their paired difference.",
        lambda found: [plot_scores(found, name)[0] for name in ("log_score", "crps")],
    ),
    Content(
        "comparison",
        "scores",
        "",
        "Log score of positions, nats per coordinate (higher is better)",
        mean_scores("log_score"),
    ),
    Content(
        "comparison",
        "scores",
        "",
        "CRPS of a coordinate, in the unit of length (lower is better)",
        mean_scores("crps"),
    ),
    Content(
        "comparison",
        "scores",
        "",
        "Energy score of a position, in the unit of length (lower is better)",
        mean_scores("energy_score"),
    ),
    Content(
        "comparison",
        "scores",
        "",
        "Share of coordinates within the central 90 % interval",
        mean_scores("coverage"),
    ),
    Content(
        "comparison",
        "scores",
        "Coverage of the forecasts' 90 % intervals",
        "Share of observed coordinates within the interval. Below the line a model is "
        "overconfident, above it underconfident.",
        plot_forecast_coverage,
    ),
    Content(
        "checks",
        "checks",
        "Recording and simulated swarms",
        "Each row is a statistic: the dot is the recording, the bar holds 90 % of the swarms "
        "simulated from the posterior.",
        plot_check_overview,
    ),
    Content(
        "checks",
        "checks",
        "",
        "Statistics of the recording against those of simulated swarms; the corrected p allows for "
        "their number",
        _verdicts,
    ),
    Content(
        "checks",
        "checks",
        "Order parameters over time",
        "The recording in the first run, and the band of 90 % of the swarms simulated from the "
        "same start. If the model is right the recording is within it in 90 % of the frames, on "
        "average.",
        _order_parameters,
    ),
    Content(
        "checks",
        "checks",
        "Statistics that differ most",
        "The recording and the swarms simulated from the model; the band holds 90 % of them at "
        "each point.",
        _statistics,
    ),
    Content(
        "checks",
        "pit",
        "Calibration of one-step forecasts",
        "Distribution of the probability that a forecast gave to less than was observed (PIT). It "
        "is uniform if forecasts are calibrated; a hump is too wide, a valley too narrow.",
        plot_pit,
    ),
    Content(
        "model",
        "fit",
        "The model as a graph",
        "Shaded nodes are observed; an arrow leads to a variable from what it is conditioned on.",
        plot_model,
    ),
    Content(
        "model",
        "fit",
        "",
        "Prior and posterior of the parameters, with the ends of the central 90 % interval",
        lambda fit: _rows(metadata.parameter_rows(fit)),
    ),
    Content(
        "model",
        "fit",
        "",
        "Model, guide and settings of the fit",
        lambda fit: _facts(metadata.model_metadata(fit)),
    ),
    Content(
        "training",
        "evaluation",
        "Loss",
        "The loss at each epoch and, where there are validation frames, theirs. Where it still "
        "falls at the end, longer training may help.",
        _training,
        "4.9, 4.10",
    ),
    Content(
        "data",
        "tracks",
        "Who was tracked when",
        "Dark: tracked; light: not. A state-space model infers what lies in a gap.",
        plot_presence,
    ),
    Content("data", "data", "", "The recording", _facts),
    Content("provenance", "provenance", "", "Settings, versions, data and digests", _facts),
]
