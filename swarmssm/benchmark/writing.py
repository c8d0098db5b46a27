"""A benchmark as files: numbers, a table for people, a page and a figure."""

from pathlib import Path

import pandas as pd

from swarmssm.analysis.plots.benchmark import plot_benchmark
from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.page import Note, Page, Prose, Table, figure
from swarmssm.benchmark.measure_method import FLOOR
from swarmssm.benchmark.models import MODELS
from swarmssm.benchmark.results import Results
from swarmssm.benchmark.thesis_tables import FOOTNOTE, thesis_table
from swarmssm.files import check_output, write_beside

__all__ = ["COLUMNS", "benchmark_page", "check_outputs", "markdown", "write_results"]

#: Endings of what is written with the table.
ENDINGS = (".csv", ".md", ".html", ".png")
COLUMNS = (
    "MSE (4.2) and MAE (4.3): one step, states scaled by the range of the training part.",
    "K steps: mean squared error of scaled states K steps ahead, of the forecast without noise.",
    "AMD and AVD error: mean distance between the cohesion (4.4) and alignment (4.5) of a free run "
    "and of the truth, in the tracks' units; without noise, and with everything drawn.",
    "CRPS K, log score K: of positions K steps ahead, lower and higher is better; a method without "
    "a noise of its own has normal errors as large as those it makes in the validation part.",
    "Edge AUC: of the inferred against the true graph, 0.5 is chance; in the csv also that of "
    "the distance alone, and of individuals exchanged.",
    "(oracle): the method knows the true forms of the forces, which others have to find.",
)


def check_outputs(path: Path, *, overwrite: bool) -> None:
    """Refuse a table that cannot or must not be written.

    Raises
    ------
    InputError
        If one of the files is there, unless it may be replaced.
    """
    for ending in ENDINGS:
        check_output(path.with_suffix(ending), overwrite=overwrite)


def write_results(results: Results, path: Path) -> list[Path]:
    """Write the table as csv, markdown and page, and the figure, in one folder.

    Raises
    ------
    WorkError
        If they cannot be written.
    """
    paths = [path.with_suffix(ending) for ending in ENDINGS]
    with write_beside(paths[0], overwrite=True) as temporary:
        results.summary().to_csv(temporary)
    with write_beside(paths[1], overwrite=True) as temporary:
        temporary.write_text(markdown(results), encoding="utf-8")
    with write_beside(paths[2], overwrite=True) as temporary:
        temporary.write_text(benchmark_page(results).html(), encoding="utf-8")
    with report_style():
        figure, _ = plot_benchmark(results.errors, _own(results), results.task.fps)
        with write_beside(paths[3], overwrite=True) as temporary:
            figure.savefig(temporary, format="png", dpi=150)
    return paths


def markdown(results: Results) -> str:
    """Return the table for a text file."""
    lines = [f"# {results.task.title}", "", *_sentences(results), ""]
    lines += [*_rows(results.shown_rows()), "", *(f"- {text}" for text in COLUMNS), ""]
    caption, rows = thesis_table(results)
    if rows:
        lines += [f"{caption}.", "", *_rows(rows), "", FOOTNOTE, ""]
    return "\n".join(lines)


def _rows(rows: list[dict[str, str]]) -> list[str]:
    """Return the lines of a table."""
    titles = list(rows[0])
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for row in rows:
        lines.append("| " + " | ".join(row[title].replace("|", "/") for title in titles) + " |")
    return lines


def benchmark_page(results: Results) -> Page:
    """Return the table and the figure as a page that needs no network."""
    with report_style():
        drawn, _ = plot_benchmark(results.errors, _own(results), results.task.fps)
        errors = figure(
            "Errors against time ahead",
            "Mean squared error of the scaled states that each method forecasts.",
            drawn,
        )
    caption, thesis = thesis_table(results)
    scores = "Scores of each method on the same frames, the best at one step first"
    return Page(
        f"Benchmark: {results.task.title}",
        [
            *(Prose(text) for text in _sentences(results)),
            Table(scores, pd.DataFrame(results.shown_rows())),
            errors,
            Note(COLUMNS),
            Table(caption, pd.DataFrame(thesis), FOOTNOTE),
        ],
    )


def _own(results: Results) -> list[str]:
    """Return this package's models, of which there are errors."""
    return [name for name in MODELS if name in results.errors["model"].values]


def _sentences(results: Results) -> list[str]:
    """Return what was done and what was found."""
    task, rows = results.task, results.rows
    trials, _ = task.forecast_origins
    parts = (task.split.train, task.split.validation, task.split.test)
    counts = [sum(s.stop - s.start for s in part) for part in parts]
    methods = [name for name in rows if name != FLOOR]
    failed = sum(rows[name]["seeds"] == 0 for name in methods)
    done = f"{len(methods)} methods" + (f", of which {failed} failed" if failed else "")
    unit = str(task.tracks.attrs.get("unit", ""))
    sentences = [
        f"{done}; {task.tracks.sizes['individual']} individuals, {counts[0]} frames to learn from, "
        f"{counts[1]} to choose weights by, {counts[2]} scored; {len(trials)} origins; "
        f"{task.fps:g} frames per second{f', unit {unit}' if unit else ''}. Methods that are given "
        f"a graph have {_graph(task.graph)}."
    ]
    if rows.get(FLOOR, {}).get("seeds") and results.fair():
        sentences.append(_floor_sentence(results))
    leads = results.verdict()
    return [*sentences, leads] if leads else sentences


def _graph(text: str) -> str:
    """Return a rule in words."""
    return "everybody see everybody" if text == "complete" else f"the rule {text}"


def _floor_sentence(results: Results) -> str:
    """Say how near the best method that is no oracle comes to the noise floor."""
    steps = results.task.steps[-1]
    near = []
    for fact, words in (("mse", "at one step"), (f"roll_{steps}", f"at {steps} steps")):
        name = results.best(results.fair(), fact)
        ratio = results.rows[name][fact] / results.rows[FLOOR][fact]
        near.append(f"{words} {name} with {ratio:.3f} times its error")
    return f"Nearest to the noise floor, oracles left aside: {', '.join(near)}."
