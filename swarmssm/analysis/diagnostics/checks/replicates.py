"""Swarms simulated from the posterior, started and observed as the recording was."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from swarmssm.analysis.posterior.subject import Subject
from swarmssm.analysis.scoring.free_runs import BOUNDS
from swarmssm.errors import InputError
from swarmssm.inference.prediction import seeded
from swarmssm.inference.prediction.base import Predictor
from swarmssm.jobs import Progress
from swarmssm.models import StateSpaceModel
from swarmssm.models.parameters import priors_of
from swarmssm.tracks import Array

__all__ = ["Runs", "replicates", "runs_of"]

Rows = npt.NDArray[np.int64]
#: Least history from which the initial state is filtered, where a trial is long enough.
HISTORY = 20
#: Longest run by default.
STEPS = 200
#: Draws at once, and pairs of individuals in all their frames.
AT_ONCE, LARGEST = 24, 5_000_000
#: Replicates with the same parameters.
COPIES = 4


@dataclass(frozen=True)
class Runs:
    """Segments of a recording, each simulated again from its first frame.

    Attributes
    ----------
    trials, rows
        ``(run,)``: where each starts.
    steps
        Frames after the start.
    seen
        ``(run, steps + 1, individual, space)``: positions, NaN where missing, and for individuals
        that are absent at the start.
    present
        ``(run, individual)``: whether an individual is present at the start, and is simulated.
    left_out
        Share of observations of individuals that enter later.
    """

    trials: Rows
    rows: Rows
    steps: int
    seen: Array
    present: npt.NDArray[np.bool_]
    left_out: float

    def __len__(self) -> int:
        return len(self.rows)


def runs_of(subject: Subject, predictor: Predictor, steps: int | None) -> Runs:
    """Cut the scored part into consecutive runs.

    Parameters
    ----------
    subject
        The data that are checked.
    predictor
        Predictor of the fit.
    steps
        Frames of a run after its start; absent, the longest trial is cut into the fewest equal
        runs of at most :data:`STEPS`. A run ends where the trial ends.

    Raises
    ------
    InputError
        If no trial is long enough for a run of ``steps``, or for any.
    """
    order = ("trial", "time", "individual", "space")
    positions = subject.tracks["position"].transpose(*order).to_numpy().astype(np.float64)
    usable = np.logical_or.reduce(subject.inputs.mask.numpy(), axis=-1)
    spans = [(0, 0) if not there.any() else _span(there) for there in usable]
    room = max(last - first for first, last in spans)
    if room < 3 or (steps is not None and steps > room):
        asked = "" if steps is None else f", and runs of {steps} steps are asked for"
        raise InputError(
            f"steps: the longest trial of the scored part has room for {max(room, 0)} steps"
            f"{asked}. Take another part (part='all'), or fewer steps."
        )
    if steps is None:
        steps = -(-room // -(-room // STEPS))
    trials, rows = [], []
    for trial, (first, last) in enumerate(spans):
        for row in range(first, max(last - max(steps // 2, 2), first) + 1, steps):
            # A run starts in a frame with at least one individual.
            start = row + int(usable[trial, row : last + 1].argmax())
            if last - start >= 2:
                trials.append(trial)
                rows.append(start)
    at = np.array(trials, dtype=np.int64), np.array(rows, dtype=np.int64)
    beginning = predictor.begin(
        subject.inputs, torch.from_numpy(at[0]), torch.from_numpy(at[1]), 0, carry=True
    )
    present = beginning.present.numpy()
    padded = np.pad(positions, ((0, 0), (0, steps), (0, 0), (0, 0)), constant_values=np.nan)
    paths = padded[at[0][:, None], at[1][:, None] + np.arange(steps + 1)]
    later = np.isfinite(paths).all(-1)
    kept = later & present[:, None]
    left_out = 1.0 - kept[:, 1:].sum() / max(1, later[:, 1:].sum())
    return Runs(*at, steps, np.where(kept[..., None], paths, np.nan), present, float(left_out))


def _span(there: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first row to start from, with some history, and the last with anybody in it."""
    rows = np.flatnonzero(there)
    first, last = int(rows[0]), int(rows[-1])
    return first + min(HISTORY, (last - first) // 4), last


def replicates(
    subject: Subject,
    predictor: Predictor,
    runs: Runs,
    draws: int,
    seed: int,
    progress: Callable[[Progress], None] | None = None,
    copies: int = COPIES,
) -> Iterator[Array | None]:
    """Yield replicates of all runs, each with its own initial states and noise.

    Parameters
    ----------
    subject, predictor, runs
        The data, the predictor of the fit, and the runs.
    draws
        Number of replicates.
    seed
        Seed of all draws.
    progress
        Called as replicates are finished.
    copies
        Replicates with the same parameters, which are simulated at once.

    Yields
    ------
    As ``runs.seen``, NaN in the same places, with the same first frame; ``None`` for one that
    diverged: it is not finite, or farther out than ``BOUNDS`` times the recording.
    """
    far = BOUNDS * max(1.0, float(np.nanmax(np.abs(runs.seen))))
    hidden = np.isnan(runs.seen)
    # Divergence counts up to the last observation of an individual.
    lasting = np.flip(np.maximum.accumulate(np.flip(~hidden.all((-1, -2)), 1), axis=1), 1)[:, 1:]
    counted = lasting[:, :, None] & runs.present[:, None]
    model = subject.fit.model
    if not (isinstance(model, StateSpaceModel) and priors_of(model)):
        # Without uncertain parameters all replicates are simulated at once.
        copies = 1
    trials, rows = (torch.from_numpy(np.tile(at, copies)) for at in (runs.trials, runs.rows))
    pairs = copies * len(runs) * runs.steps * runs.present.shape[1] ** 2
    size = max(1, min(AT_ONCE // copies, LARGEST // pairs))
    done = 0
    with seeded(seed):
        while done < draws:
            number = min(size, -(-(draws - done) // copies))
            beginning = predictor.begin(subject.inputs, trials, rows, number, carry=True)
            states = predictor.run(beginning, runs.steps, sample=True).states
            for draw in range(number):
                values = {} if beginning.parameters is None else beginning.parameters[draw]
                drawn = _observed(subject, states[draw], values)
                for positions in np.split(drawn, copies)[: draws - done]:
                    done += 1
                    good = (np.abs(positions) <= far).all(-1)
                    if (good | ~counted).all():
                        whole = np.concatenate([runs.seen[:, :1], positions], axis=1)
                        yield np.where(hidden, np.nan, whole)
                    else:
                        yield None
            if progress is not None:
                progress(Progress(done, draws))


def _observed(subject: Subject, states: torch.Tensor, values: Mapping[str, Any]) -> Array:
    """Return the observed positions of one draw, in the units of the tracks."""
    model, scaler = subject.fit.model, subject.fit.preparation.scaler
    space = subject.num_space
    observed = states[..., :space]
    if isinstance(model, StateSpaceModel) and not model.emission.is_exact:
        # An absent individual has no state; what is drawn for it is masked.
        with subject.fit.with_parameters(values), torch.no_grad():
            observed = model.emission(states.nan_to_num()).sample()[..., :space]
        observed = observed.masked_fill(states[..., :1].isnan(), torch.nan)
    offset, scale = np.array(scaler.offset[:space]), np.array(scaler.scale[:space])
    positions: Array = observed.numpy().astype(np.float64) * scale + offset
    return positions
