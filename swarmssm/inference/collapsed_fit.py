"""Fit a model with its latent paths summed out, for a :class:`LinearizedGuide`."""

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
from pyro.infer import Trace_ELBO

from swarmssm.errors import WorkError
from swarmssm.inference.collapsed_model import collapsed, windows_plate
from swarmssm.inference.convergence import add_distances
from swarmssm.inference.filtering.evidence import linearization_points
from swarmssm.inference.filtering.layouts import Points
from swarmssm.inference.guides.linearized import LinearizedGuide
from swarmssm.inference.laplace_method import laplace
from swarmssm.inference.training import num_coordinates, quiet_pyro
from swarmssm.models import StateSpaceModel, SwarmBatch

__all__ = ["fit_collapsed"]

#: Steps of the optimiser between two moves of the points of linearisation.
MOVE_POINTS = 25
ROWS = 100
#: Steps of Adam unless the caller says otherwise.
ADAM_STEPS = 1000


def fit_collapsed(
    model: StateSpaceModel,
    guide: LinearizedGuide,
    windows: SwarmBatch,
    *,
    validation: SwarmBatch | None = None,
    steps: int | None = None,
    batch_windows: int | None = None,
    lr: float = 0.01,
    seed: int = 0,
    callback: Callable[[int, int | None, float], None] | None = None,
) -> list[dict[str, float]]:
    """Fit the parameters of a model, and the guide of those with a prior.

    As ``guide.globals`` says: by Laplace's method, on all windows; or by stochastic variational
    inference with Adam on mini-batches, at points of linearisation that are moved to the posterior
    path of the guide's median now and then. Global random states are left as they were.

    Parameters
    ----------
    model, guide
        Changed in place: the parameters of the model that are learned without a prior, and
        the guide's normal over those with one.
    windows
        All windows to fit.
    validation
        Windows to score at the guide's median after the fit; ``None`` for none.
    steps
        Steps at most: of L-BFGS, which absent goes on until the maximum stands; or of Adam, absent
        1000.
    batch_windows, lr, seed
        Of stochastic variational inference: windows in a mini-batch (``None``, all), learning
        rate, which falls to a tenth at the last step, and the seed of mini-batches and draws.
        Laplace's method takes all windows at once, and has no use for them.
    callback
        Called after each evaluation with the number of the step, the number of them all (``None``
        if that is not known), and the loss.

    Returns
    -------
    The history, a row for each step of L-BFGS or about every hundredth step of Adam: ``epoch``,
    ``step``, ``loss`` (the negative log-density, or ELBO, per observed coordinate),
    ``validation_loss`` (NaN in all but the last row, or without ``validation``), ``seconds``, and
    ``distance`` (:func:`swarmssm.inference.convergence.convergence`).

    Raises
    ------
    InputError
        If there is nothing to fit.
    WorkError
        If the evidence breaks down, or the loss is not a number.
    """
    number = num_coordinates(windows, model)
    fit = _by_laplace if guide.globals == "laplace" else _by_svi
    options = {"steps": steps, "batch_windows": batch_windows, "lr": lr}
    began = time.perf_counter()
    rows: list[dict[str, float]] = []
    places: list[torch.Tensor] = []

    def note(step: int, total: int | None, loss: float, place: torch.Tensor | None) -> None:
        if place is not None:
            places.append(place)
            rows.append(
                {
                    "epoch": float(step),
                    "step": float(step),
                    "loss": loss / number,
                    "validation_loss": math.nan,
                    "seconds": time.perf_counter() - began,
                }
            )
        if callback is not None:
            callback(step, total, loss / number)

    with quiet_pyro(), torch.random.fork_rng():
        torch.manual_seed(seed)
        fit(model, guide, windows, note, options)
        if validation is not None and rows:
            rows[-1]["validation_loss"] = _score(model, guide, validation)
        _, sd = guide.parameters_guide.unconstrained()
    add_distances(rows, places, sd.double())
    return rows


def _by_laplace(
    model: StateSpaceModel,
    guide: LinearizedGuide,
    windows: SwarmBatch,
    note: Callable[..., None],
    options: dict[str, Any],
) -> None:
    """Put Laplace's normal into the guide."""
    found = laplace(
        model,
        windows,
        layout=guide.layout,
        given=_given(guide, windows),
        steps=options["steps"],
        callback=lambda step, loss, place: note(step, options["steps"], loss, place),
    )
    found.fill(guide.parameters_guide)


def _by_svi(
    model: StateSpaceModel,
    guide: LinearizedGuide,
    windows: SwarmBatch,
    note: Callable[..., None],
    options: dict[str, Any],
) -> None:
    """Maximise the ELBO of the parameters alone."""
    steps, size = options["steps"] or ADAM_STEPS, options["batch_windows"] or len(windows)
    parameters = guide.parameters_guide
    target = collapsed(model, layout=guide.layout, given=_given(guide, windows))
    weights = {id(p): p for part in (model, guide) for p in part.parameters()}
    learned = [p for p in weights.values() if p.requires_grad]
    optimizer = torch.optim.Adam(learned, lr=options["lr"])
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.1 ** (1.0 / steps))
    elbo = Trace_ELBO()

    def draw(batch: SwarmBatch) -> None:
        parameters()
        if guide.has_edges:
            with windows_plate(batch):
                guide.edges_guide(batch)

    points: Points | None = None
    every = max(1, steps // ROWS)
    batches = _batches(len(windows), min(size, len(windows)))
    for step in range(1, steps + 1):
        if (step - 1) % MOVE_POINTS == 0:
            middle = parameters.median()
            known = guide.with_edges(windows, sample=False)
            points = linearization_points(model, known, middle, layout=guide.layout, start=points)
        index = next(batches)
        if points is not None:
            target.points = Points(points.mean[index], points.covariance[index])
        optimizer.zero_grad()
        total = elbo.differentiable_loss(target, draw, windows.select(index))
        total.backward()
        optimizer.step()
        schedule.step()
        loss = float(total.detach())
        if not math.isfinite(loss):
            raise WorkError(
                f"The loss is not a number at step {step}. Try a smaller learning rate."
            )
        place = parameters.unconstrained()[0] if step % every == 0 or step == steps else None
        note(step, steps, loss, place)


def _given(guide: LinearizedGuide, windows: SwarmBatch) -> int:
    """Return how many frames of each window are not scored."""
    return min(guide.given, windows.num_times // 4)


def _batches(number: int, size: int) -> Iterator[torch.Tensor]:
    """Yield mini-batches of one pass after another, each in a random order."""
    while True:
        yield from torch.split(torch.randperm(number), size)


def _score(model: StateSpaceModel, guide: LinearizedGuide, windows: SwarmBatch) -> float:
    """Return the negative evidence per coordinate at the guide's median."""
    target = collapsed(model, layout=guide.layout, given=_given(guide, windows))
    values = guide.parameters_guide.median()
    with torch.no_grad():
        evidence = target.evidence(guide.with_edges(windows, sample=False), values)
    return -float(evidence) / num_coordinates(windows, model)
