"""The scores of the thesis as tables: one step, free runs and edges, errors ahead."""

from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.table import NOTHING, format_number
from swarmssm.analysis.scoring.thesis import thesis_rows

__all__ = ["edge_table", "horizon_table", "scores_table"]


def scores_table(evaluation: Evaluation, thesis: str | None = "auto") -> list[dict[str, str]]:
    """Return one row a method, column title to text, all rows with the same columns.

    Parameters
    ----------
    evaluation
        Of a fit.
    thesis
        Which of the thesis's printed tables to add: ``"boids"``, ``"guppies"``, ``None``; or
        ``"auto"``: Table II for simulated tracks, else Table I. See
        :mod:`swarmssm.analysis.scoring.thesis` why they cannot be compared.

    Returns
    -------
    The model, the references, the truth (of which only AMD and AVD are scores), and the thesis's
    rows. Each number has three significant digits; a dash stands where there is none.

    Raises
    ------
    InputError
        If ``thesis`` is unknown.
    """
    if thesis == "auto":
        thesis = evaluation.settings["thesis"]
    number = format_number
    titles = dict(zip(_values(evaluation, "method"), _values(evaluation, "title"), strict=True))
    rows = [
        {
            "method": title,
            "MSE": number(evaluation.score("mse", name)),
            "MAE": number(evaluation.score("mae", name)),
            "AMD": number(evaluation.score("amd_mean", name)),
            "AMD error": number(evaluation.score("amd_error", name)),
            "AVD": number(evaluation.score("avd_mean", name)),
            "AVD error": number(evaluation.score("avd_error", name)),
            "edge accuracy": number(evaluation.edge_score("accuracy", name)),
        }
        for name, title in titles.items()
    ]
    blank = dict.fromkeys(rows[0], NOTHING)
    rows.append(
        blank
        | {
            "method": "truth",
            "AMD": number(evaluation.score("amd_mean", "truth")),
            "AVD": number(evaluation.score("avd_mean", "truth")),
        }
    )
    rows += [
        blank
        | {
            "method": row.title,
            "MSE": number(row.mse),
            "AMD": number(row.amd),
            "AVD": number(row.avd),
        }
        for row in thesis_rows(thesis)
    ]
    return rows


def horizon_table(evaluation: Evaluation, score: str = "squared_error") -> list[dict[str, str]]:
    """Return one row a method with its error at each horizon.

    Parameters
    ----------
    evaluation
        Of a fit.
    score
        ``"squared_error"``: plain mean over components of the squared error of scaled states;
        ``"forecast_mse"``, ``"forecast_mae"``: (4.2), (4.3) at that step; ``"log_score"``: nats
        per coordinate of position, higher is better; ``"crps"``, in the tracks' unit;
        ``"coverage"``: share of coordinates inside the 90 % interval.
    """
    return [
        {"method": title}
        | {
            f"{step} step" + "s" * (step > 1): format_number(evaluation.score(score, name, step))
            for step in evaluation.settings["horizons"]
        }
        for name, title in zip(
            _values(evaluation, "method"), _values(evaluation, "title"), strict=True
        )
    ]


def edge_table(evaluation: Evaluation) -> list[dict[str, str]]:
    """Return one row a predictor of the next graph, with means over time."""
    titles = [str(title) for title in evaluation.edges["title"].values]
    names = [str(name) for name in evaluation.edges["predictor"].values]
    return [
        {"predictor": title}
        | {
            score: format_number(evaluation.edge_score(score.lower(), name))
            for score in ("accuracy", "precision", "recall", "AUC")
        }
        for name, title in zip(names, titles, strict=True)
    ]


def _values(evaluation: Evaluation, name: str) -> list[str]:
    """Return a coordinate of the scores as text."""
    return [str(value) for value in evaluation.scores[name].values]
