"""What is to be seen, in words that follow from the numbers."""

import math

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.report.wording import (
    ALIKE,
    better,
    capital,
    percent,
    quantity,
    times,
    title_of,
)
from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.table import format_number as number
from swarmssm.tracks import Array

__all__ = [
    "collective_sentence",
    "edge_sentence",
    "edges_vary",
    "graphs_sentence",
    "horizon_sentence",
    "imitation_sentence",
    "one_step_sentence",
    "random_starts_sentence",
    "snapshots_sentence",
    "training_sentence",
    "verdict",
]

SIMPLE = ("stay-put", "constant-velocity")


def verdict(evaluation: Evaluation) -> tuple[str, list[str]]:
    """Return one sentence that sums up, and one each on what it rests on."""
    model = title_of(evaluation, evaluation.model)
    steps = _farthest(evaluation)
    judged = {
        "one step ahead": better(*_named_rival(evaluation, "mse")[:2]),
        f"{steps} steps ahead": None
        if steps == 1
        else better(*_named_rival(evaluation, "squared_error", steps)[:2]),
        "in predicting the next graph": _judge_edges(evaluation),
        "in the cohesion of free runs": better(*_named_rival(evaluation, "amd_error")[:2]),
        "in the alignment of free runs": better(*_named_rival(evaluation, "avd_error")[:2]),
    }
    outcomes = (
        (1, "beats the best of them"),
        (0, "is as good as the best of them"),
        (-1, "does worse than the best of them"),
    )
    parts = []
    for outcome, words in outcomes:
        where = [name for name, result in judged.items() if result == outcome]
        if where:
            parts.append((words, joined(where)))
    sentences = [
        one_step_sentence(evaluation),
        horizon_sentence(evaluation),
        edge_sentence(evaluation),
        collective_sentence(evaluation, "amd"),
        collective_sentence(evaluation, "avd"),
    ]
    reasons = [sentence for sentence in sentences if sentence]
    if not parts:
        return f"Nothing could be compared for {model}.", reasons
    # Whichever comes first says in full whom "them" means.
    rivals = "the best of the simple rivals (stay put, constant velocity, an unchanged graph)"
    first = parts[0][0].replace("the best of them", rivals)
    clauses = [f"{first} {parts[0][1]}", *(f"{words} {where}" for words, where in parts[1:])]
    everywhere = len(parts) == 1 and len([r for r in judged.values() if r is not None]) > 1
    summary = f"{model} " + "; it ".join(clauses)
    return capital(summary) + (": on every count." if everywhere else "."), reasons


def one_step_sentence(evaluation: Evaluation) -> str:
    """Say who predicts one step best, and how far the noise floor is."""
    model = title_of(evaluation, evaluation.model)
    own, rival, name = _named_rival(evaluation, "mse")
    if math.isnan(own):
        return ""
    if math.isnan(rival):
        text = f"One step ahead, {model} has an MSE of {number(own)}"
    else:
        result = better(own, rival)
        if result == 0:
            text = (
                f"One step ahead, {model} and {name} do equally well (MSE {number(own)} and "
                f"{number(rival)})"
            )
        else:
            winner, loser = (model, name) if result == 1 else (name, model)
            low, high = sorted((own, rival))
            text = (
                f"{capital(winner)} has the lower one-step error: MSE {number(low)} against "
                f"{number(high)} for {loser}"
            )
    floor = evaluation.score("mse", "noise-floor")
    if floor > 0 and math.isfinite(own):
        text += (
            f"; {model} is at the noise floor, {number(floor)}"
            if own <= floor * (1 + ALIKE)
            else f"; the noise floor, {number(floor)}, is {times(own / floor)} below {model}"
        )
    return text + "."


def horizon_sentence(evaluation: Evaluation) -> str:
    """Say from how many steps on the model beats constant velocity and stay-put."""
    scores, model = evaluation.scores, evaluation.model
    own = scores["squared_error"].sel({"method": model}).to_numpy()
    rivals = [m for m in SIMPLE if m in scores["method"]]
    best = np.min([scores["squared_error"].sel({"method": m}).to_numpy() for m in rivals], axis=0)
    steps = scores["step"].to_numpy()
    known = ~(np.isnan(own) | np.isnan(best))
    if not known.any():
        return ""
    words = "the better of stay put and constant velocity"
    title = title_of(evaluation, model)
    below = own[known] < best[known]
    steps = steps[known]
    last = int(steps[-1])
    end = f"{number(float(own[known][-1]))} against {number(float(best[known][-1]))}"
    far = f"at {last} step{'s' * (last > 1)} its squared error is {end}"
    if below.all():
        text = f"{capital(title)} errs less than {words} at every number of steps up to {last}"
    elif not below.any():
        text = f"{capital(title)} errs more than {words} at every number of steps up to {last}"
    elif below[-1] and (np.diff(below.astype(int)) != 0).sum() == 1:
        first = int(steps[np.argmax(below)])
        text = f"{capital(title)} errs less than {words} only from {first} steps ahead on"
    elif not below[-1] and (np.diff(below.astype(int)) != 0).sum() == 1:
        first = int(steps[np.argmin(below)])
        text = f"{capital(title)} errs less than {words} only below {first} steps ahead"
    else:
        some = f"{int(below.sum())} of {len(below)} numbers of steps ahead"
        text = f"{capital(title)} errs less than {words} at {some}"
    return f"{text}; {far}."


def edges_vary(evaluation: Evaluation) -> bool:
    """Return whether some pairs are linked and others not: else no graph is to be predicted."""
    density = evaluation.edges["density"].to_numpy()
    known = density[np.isfinite(density)]
    return not known.size or bool(known.min() < 1.0 and known.max() > 0.0)


def edge_sentence(evaluation: Evaluation) -> str:
    """Say how much of the next graph is predicted rightly, beside what needs no model."""
    model = evaluation.model
    own = evaluation.edge_score("accuracy", model)
    if math.isnan(own) or not edges_vary(evaluation):
        return ""
    known = {str(name) for name in evaluation.edges["predictor"].values}
    commoner = str(evaluation.edges["title"].sel(predictor="commoner").item())
    words = {
        "stay-put": "the same graph as before is right on",
        "commoner": f"{commoner} on",
    }
    others = [
        f"{text} {percent(evaluation.edge_score('accuracy', name))}"
        for name, text in words.items()
        if name in known
    ]
    auc = evaluation.edge_score("auc", model)
    text = (
        f"{capital(title_of(evaluation, model))} is right on {percent(own)} of the pairs of the "
        f"next graph, where {joined(others)}"
    )
    if not math.isnan(auc):
        text += f" (AUC {number(auc)}, where 0.5 knows nothing)"
    return text + "."


def collective_sentence(evaluation: Evaluation, score: str) -> str:
    """Say whether free runs hold together (AMD) or head alike (AVD) as the truth does."""
    own = evaluation.score(f"{score}_mean", evaluation.model)
    true = evaluation.score(f"{score}_mean", "truth")
    if math.isnan(own) or math.isnan(true):
        return ""
    unit = evaluation.settings["unit"]
    measure = unit if score == "amd" else f"{unit}/s".removeprefix("/s")
    model = title_of(evaluation, evaluation.model)
    if math.isinf(own):
        return f"Free runs of {model} leave all bounds."
    what, low, high, alike = {
        "amd": (
            "the mean distance to the nearest neighbour (AMD)",
            "are tighter than the true group",
            "are looser than the true group",
            "are as tight as the true group",
        ),
        "avd": (
            "the mean difference of two velocities (AVD)",
            "move more alike than the true group",
            "move less alike than the true group",
            "move as alike as the true group",
        ),
    }[score]
    compared = alike if better(own, true) == 0 else (low if own < true else high)
    error, rival, name = _named_rival(evaluation, f"{score}_error")
    text = (
        f"Free runs of {model} {compared}: {what} is {quantity(own, measure)} against "
        f"{quantity(true, measure)}, and over time it is off by {number(error)}"
    )
    result = better(error, rival)
    if result is not None:
        words = {1: "less than", 0: "as much as", -1: "more than"}[result]
        text += f", {words} {name} ({number(rival)})"
    return text + "."


def imitation_sentence(evaluation: Evaluation) -> str:
    """Say how far imitated paths lie from the true ones."""
    data = evaluation.imitation
    true, single, free = (
        data[name].transpose("time", "individual", "space").to_numpy()
        for name in ("true", "one_step", "free_run")
    )
    unit = data.attrs.get("unit", "")
    off, step = _mean_distance(single, true), _mean_distance(true[:-1], true[1:])
    if math.isnan(off) or math.isnan(step):
        return ""
    text = (
        f"Predicted one step at a time, individuals are {quantity(off, unit)} from where they "
        f"truly are, {times(off / step)} the length of a true step"
    )
    late = slice(-max(1, len(true) // 10), None)
    end = _mean_distance(free[late], true[late])
    still = _mean_distance(np.broadcast_to(true[0], true[late].shape), true[late])
    if not math.isnan(end):
        seconds = float(data["time"][-1])
        text += (
            f"; running freely, {quantity(end, unit)} after {number(seconds)} s, where it would be "
            f"{quantity(still, unit)} had nobody moved"
        )
    return text + "."


def snapshots_sentence(evaluation: Evaluation) -> str:
    """Say whether the free run is as tight and as ordered as the truth at its end."""
    data = evaluation.imitation.isel(time=slice(-1, None))
    words = []
    for name, word in (("true", "the true group"), ("free_run", "the imitated one")):
        position = data[name].transpose("time", "individual", "space").to_numpy()
        velocity = data[f"{name}_velocity"].transpose("time", "individual", "space").to_numpy()
        distance, order = metrics.amd(position)[0], metrics.polarization(velocity)[0]
        if math.isnan(distance) or math.isnan(order):
            return ""
        unit = data.attrs.get("unit", "")
        words.append(
            f"{word} keeps {quantity(float(distance), unit)} from neighbour to neighbour with a "
            f"polarization of {number(float(order))}"
        )
    seconds = float(data["time"][-1])
    return f"After {number(seconds)} s {words[0]}, {words[1]} (1: all head one way)."


def graphs_sentence(evaluation: Evaluation) -> str:
    """Count true, predicted and common edges of the snapshots."""
    data = evaluation.graphs
    probability = data["probability"].to_numpy()
    pairs = ~np.isnan(probability) & ~np.eye(probability.shape[-1], dtype=bool)
    if not pairs.any():
        return "No graph was predicted for these frames."
    true = data["true"].to_numpy().astype(bool) & pairs
    claimed = (np.where(pairs, probability, 0.0) >= 0.5) & pairs
    right = (true == claimed)[pairs].mean()
    return (
        f"In the {data.sizes['snapshot']} graphs shown there are {true.sum()} edges, and "
        f"{claimed.sum()} are predicted, of which {(true & claimed).sum()} are true; "
        f"{percent(float(right))} of all pairs are right."
    )


def training_sentence(history: xr.Dataset) -> str:
    """Say how far the loss fell, whether it was still falling, and which weights were kept."""
    if "loss" not in history or history.sizes.get("epoch", 0) == 0:
        return "The course of training is not known."
    epochs = history["epoch"].to_numpy().astype(int)
    loss = history["loss"].to_numpy()
    first, last = number(float(loss[0])), number(float(loss[-1]))
    text = (
        f"The loss fell from {first} to {last} nats per coordinate in {epochs[-1]} epochs"
        if loss[-1] < loss[0]
        else f"The loss did not fall: {first} at first, {last} nats per coordinate after "
        f"{epochs[-1]} epochs"
    )
    fallen = float(loss[0] - loss[-1])
    lately = float(loss[-max(2, len(loss) // 10) :][0] - loss[-1])
    if len(loss) > 2 and fallen > 0:
        text += (
            f"; in the last tenth it still fell by {number(lately)}, so that longer training may "
            "help"
            if lately > 0.02 * fallen
            else "; at the end it hardly fell any more"
        )
    kept = len(loss) - 1
    if "validation_loss" in history and np.isfinite(history["validation_loss"]).any():
        kept = int(np.nanargmin(history["validation_loss"].to_numpy()))
        text += (
            ", and the weights are those of the last epoch"
            if kept == len(loss) - 1
            else f", and the weights are those of epoch {epochs[kept]}, where the validation loss "
            "was least"
        )
    return text + _lower_elsewhere(history, epochs, kept) + "."


def _lower_elsewhere(history: xr.Dataset, epochs: npt.NDArray[np.int64], kept: int) -> str:
    """Say so if the one-step error was clearly lower in another epoch than the kept one."""
    if "mse" not in history or not np.isfinite(history["mse"]).any():
        return ""
    error = history["mse"].to_numpy()
    least = int(np.nanargmin(error))
    if better(float(error[least]), float(error[kept])) != 1:
        return ""
    when = "before" if least < kept else "later"
    return (
        f"; the one-step MSE, which is not what the loss measures, was lower {when}: "
        f"{number(float(error[least]))} in epoch {epochs[least]} against "
        f"{number(float(error[kept]))}"
    )


def random_starts_sentence(evaluation: Evaluation) -> str:
    """Say what becomes of groups that start at random."""
    runs = evaluation.random_starts
    position = runs["position"].transpose("run", "time", "individual", "space").to_numpy()
    velocity = runs["velocity"].transpose("run", "time", "individual", "space").to_numpy()
    unit = runs.attrs.get("unit", "")
    distance = metrics.amd(position)
    order = metrics.polarization(velocity)
    if np.isnan(distance[:, 0]).all():
        return ""
    start, order_start = float(np.nanmean(distance[:, 0])), float(np.nanmean(order[:, 0]))
    if np.isnan(distance[:, -1]).all() or np.isnan(order[:, -1]).all():
        return "All runs from random starts left all bounds."
    end, order_end = float(np.nanmean(distance[:, -1])), float(np.nanmean(order[:, -1]))
    true = evaluation.score("amd_mean", "truth")
    seconds = float(runs["time"][-1])
    text = (
        f"From random places and headings, the distance to the nearest neighbour goes from "
        f"{quantity(start, unit)} to {quantity(end, unit)} in {number(seconds)} s"
    )
    text += "" if math.isnan(true) else f" (true group: {quantity(true, unit)})"
    return f"{text}, the polarization from {number(order_start)} to {number(order_end)}."


def _mean_distance(first: Array, second: Array) -> float:
    """Return the mean distance of places where both are known; NaN if nowhere."""
    distance = np.linalg.norm(first - second, axis=-1)
    known = np.isfinite(distance)
    return float(distance[known].mean()) if known.any() else math.nan


def _named_rival(
    evaluation: Evaluation, score: str, step: int | None = None
) -> tuple[float, float, str]:
    """Return the model's error, that of the better simple rival, and the rival's title."""
    own = evaluation.score(score, evaluation.model, step)
    rivals = {name: evaluation.score(score, name, step) for name in SIMPLE}
    known = {name: value for name, value in rivals.items() if not math.isnan(value)}
    if not known:
        return own, math.nan, ""
    name = min(known, key=lambda key: known[key])
    return own, known[name], title_of(evaluation, name)


def _judge_edges(evaluation: Evaluation) -> int | None:
    """Compare wrong pairs of the model with those of the better of two that need no model."""
    if not edges_vary(evaluation):
        return None
    own = 1 - evaluation.edge_score("accuracy", evaluation.model)
    others = [1 - evaluation.edge_score("accuracy", name) for name in ("stay-put", "commoner")]
    return better(own, min((wrong for wrong in others if not math.isnan(wrong)), default=math.nan))


def _farthest(evaluation: Evaluation) -> int:
    """Return the longest horizon."""
    horizons = evaluation.settings["horizons"]
    return max(horizons) if horizons else int(evaluation.scores["step"][-1])
