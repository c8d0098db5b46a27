"""Whole swarms from the posterior, started where the recording was, and seen as it was seen."""

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
#: Frames from which the first state of a run is filtered at least, if a trial is long enough.
HISTORY = 20
#: Longest run where none is asked for.
STEPS = 200
#: Draws that run at once, so that progress is seen, and pairs of all their frames.
AT_ONCE, LARGEST = 24, 5_000_000
#: Replicates that have their parameters in common.
COPIES = 4


@dataclass(frozen=True)
class Runs:
    """Stretches of a recording, each to be run again from its first frame.

    Attributes
    ----------
    trials, rows
        ``(run,)``: where each starts.
    steps
        Frames after the start.
    seen
        ``(run, steps + 1, individual, space)``: positions, NaN where not seen, and for those who
        are not there at the start.
    present
        ``(run, individual)``: who is there at the start, and therefore runs.
    left_out
        Share of sightings that are of others, who came later.
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
    """Cut the scored part into runs that follow each other.

    Parameters
    ----------
    subject
        What is checked.
    predictor
        Says who can be started.
    steps
        Frames of a run after its start; absent, the longest trial in as few equal runs as
        have at most :data:`STEPS`. A run is cut short where the trial ends.

    Raises
    ------
    InputError
        If no trial has room for a run of ``steps``, or for any.
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
            # Nobody can be started from a frame in which nobody is.
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
    """Yield replicates of all runs, each with first states and noise of its own.

    Parameters
    ----------
    subject, predictor, runs
        What is run again, and by whom.
    draws
        How many.
    seed
        Of all draws.
    progress
        Called as replicates are finished.
    copies
        How many have their parameters in common; each draw of these runs by itself, while copies
        run at once.

    Yields
    ------
    As ``runs.seen``, NaN in the same places, with the same first frame; ``None`` for one that flew
    off: it is not finite, or farther out than ``BOUNDS`` times
    the recording.
    """
    far = BOUNDS * max(1.0, float(np.nanmax(np.abs(runs.seen))))
    hidden = np.isnan(runs.seen)
    # How long somebody is seen: what happens after that is nobody's business.
    lasting = np.flip(np.maximum.accumulate(np.flip(~hidden.all((-1, -2)), 1), axis=1), 1)[:, 1:]
    counted = lasting[:, :, None] & runs.present[:, None]
    model = subject.fit.model
    if not (isinstance(model, StateSpaceModel) and priors_of(model)):
        # Without parameters to be drawn all draws run at once anyway.
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
                drawn = _sighted(subject, states[draw], values)
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


def _sighted(subject: Subject, states: torch.Tensor, values: Mapping[str, Any]) -> Array:
    """Return where the individuals of one draw are seen, in the tracks' own units."""
    model, scaler = subject.fit.model, subject.fit.preparation.scaler
    space = subject.num_space
    observed = states[..., :space]
    if isinstance(model, StateSpaceModel) and not model.emission.is_exact:
        # An individual that is not there has no state; what is drawn for it is not looked at.
        with subject.fit.with_parameters(values), torch.no_grad():
            observed = model.emission(states.nan_to_num()).sample()[..., :space]
        observed = observed.masked_fill(states[..., :1].isnan(), torch.nan)
    offset, scale = np.array(scaler.offset[:space]), np.array(scaler.scale[:space])
    positions: Array = observed.numpy().astype(np.float64) * scale + offset
    return positions
