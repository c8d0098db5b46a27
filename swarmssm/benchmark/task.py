"""What every method of a benchmark is given, and what it is scored on."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.posterior.frames import rolling_origins
from swarmssm.analysis.posterior.subject import ScoredTracks
from swarmssm.analysis.scoring.rolling_origin import HORIZONS, check_horizons
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule, rule_of
from swarmssm.inference.fitting import tracks_digest
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array, states_of, validate_tracks, with_trials
from swarmssm.tracks.scaling import Scaler, fit_scaler
from swarmssm.tracks.splits import Segment, Split, split, take

__all__ = ["HISTORY", "Task", "make_task"]

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
#: Frames before the first forecast that any method may look at.
HISTORY = 49


@dataclass(frozen=True)
class Task:
    """Tracks with a split, and the frames of its test part that all methods are scored on.

    It can be sent to another process.

    Attributes
    ----------
    title
        For tables.
    tracks
        All, with trials.
    split
        Parts to learn from, to choose weights by, and to be scored on.
    graph
        Rule of who sees whom, for methods that do not find it out; ``"complete"``: all see all.
    horizons
        Rising numbers of frames ahead.
    origins
        Forecasts in each trial.
    free_steps, starts, draws
        Length of free runs, their number in each trial, and how often each is drawn.
    samples
        Futures from which the density of a forecast is taken.
    seed
        Of the draws that scores are made of.
    """

    title: str
    tracks: xr.Dataset
    split: Split
    graph: str
    horizons: tuple[int, ...] = HORIZONS
    origins: int = 40
    free_steps: int = 200
    starts: int = 5
    draws: int = 10
    samples: int = 100
    seed: int = 0

    @property
    def fps(self) -> float:
        """Frames per second."""
        return float(self.tracks.attrs["fps"])

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""
        return int(self.tracks.sizes["space"])

    @property
    def exact(self) -> bool:
        """Whether the states are those of a simulation, without tracking noise."""
        about = json.loads(self.tracks.attrs.get("simulation", "{}"))
        return "velocity" in self.tracks and about.get("observation_noise") == 0.0

    def rule(self) -> GraphRule | None:
        """Return the rule that methods are given; ``None`` where all see all."""
        return None if self.graph == "complete" else GraphRule.parse(self.graph)

    @cached_property
    def _context(self) -> tuple[tuple[Segment, ...], Rows]:
        """Return the scored frames with those before them, and the first scored row of each."""
        segments, first = [], []
        for segment in self.split.test:
            start = max(0, segment.start - HISTORY)
            # A trial that begins with the test part has nothing before it to look back on.
            own = min(HISTORY, (segment.stop - segment.start) // 4) if start == segment.start else 0
            segments.append(Segment(segment.trial, start, segment.stop))
            first.append(max(1, segment.start - start + own))
        return tuple(segments), np.array(first)

    @cached_property
    def context(self) -> xr.Dataset:
        """The test part with up to :data:`HISTORY` frames before it, a trial a segment."""
        return take(self.tracks, self._context[0])

    @cached_property
    def states(self) -> Array:
        """States of the context ``(trial, time, individual, state)``, NaN where unknown."""
        return _whole(states_of(self.context))

    @cached_property
    def mask(self) -> Mask:
        """The states that are scored, ``(trial, time, individual)``."""
        scored = np.arange(self.states.shape[1])[None, :] >= self._context[1][:, None]
        mask: Mask = known(self.states) & scored[..., None]
        return mask

    @cached_property
    def scored(self) -> ScoredTracks:
        """The context; errors of baselines are measured in the validation part, if there is one."""
        errors = self.training if self.validation is None else self.validation
        return ScoredTracks(self.context, self.states, self.mask, errors, self.scaler)

    @cached_property
    def training(self) -> Array:
        """States of the training part."""
        return _whole(states_of(take(self.tracks, self.split.train)))

    @cached_property
    def validation(self) -> Array | None:
        """States of the validation part, if there is one."""
        if not self.split.validation:
            return None
        return _whole(states_of(take(self.tracks, self.split.validation)))

    @cached_property
    def scaler(self) -> Scaler:
        """Range of each feature in the training part, (3.49)."""
        return fit_scaler(self.training)

    @cached_property
    def forecast_origins(self) -> tuple[Rows, Rows]:
        """Trial and row of the frames of the context that are gone on from.

        At each of them somebody's state is known, and somebody is seen later.
        """
        first = self._context[1]
        rows = np.arange(self.states.shape[1])[None, :]
        # The last frame of the history may be the one before the first that is scored.
        startable = (rows >= first[:, None] - 1) & known(self.states).any(-1)
        seen = self.mask | (startable[..., None] & known(self.states))
        return rolling_origins(seen, self.origins, startable)

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """The horizons that the scored frames have room for."""
        trials, rows = self.forecast_origins
        seen = self.mask.any(-1)
        last = np.where(seen, np.arange(seen.shape[1]), -1).max(-1)
        room = int((last[trials] - rows).max(initial=0))
        used = tuple(k for k in self.horizons if k <= room)
        if not used:
            raise InputError(
                f"horizons: the test part has room for at most {room} steps ahead. Ask for nearer "
                "horizons, or give more frames."
            )
        return used

    def digest(self) -> str:
        """Return what must be the same for two measurements to stand in one table."""
        facts = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("tracks", "split", "title")
        }
        return json.dumps(
            {"tracks": tracks_digest(self.tracks), "split": self.split.to_dict(), **facts},
            sort_keys=True,
        )


def make_task(
    tracks: xr.Dataset,
    *,
    title: str = "",
    graph: str | None = None,
    split_by: str = "auto",
    fractions: Sequence[float] = (0.7, 0.15, 0.15),
    horizons: Sequence[int] = HORIZONS,
    origins: int = 40,
    free_steps: int = 200,
    starts: int = 5,
    draws: int = 10,
    samples: int = 100,
    seed: int = 0,
) -> Task:
    """Split tracks, and decide what is scored.

    Parameters
    ----------
    tracks
        Tracks.
    title
        For tables.
    graph
        Rule of who sees whom; absent, that of a simulation, and of any other tracks
        ``"complete"``.
    split_by, fractions
        See :func:`swarmssm.tracks.splits.split`.
    horizons, origins, free_steps, starts, draws, samples, seed
        See :class:`Task`.

    Raises
    ------
    InputError
        If an argument is out of range, there is no test part, or nothing in it can be scored.
    """
    counts = {
        "origins": origins,
        "free_steps": free_steps,
        "starts": starts,
        "draws": draws,
    }
    for name, value in counts.items():
        if value < 1:
            raise InputError(f"{name}: it must be at least 1, and it is {value}.")
    if samples < 10:
        raise InputError(f"samples: it must be at least 10, and it is {samples}.")
    check_horizons(horizons)
    tracks = with_trials(validate_tracks(tracks))
    parts = split(tracks, split_by, fractions)
    if not parts.test:
        raise InputError("fractions: the test part is empty, and nothing can be scored.")
    if graph is None:
        rule = rule_of(tracks) if "adjacency" in tracks else None
        graph = "complete" if rule is None else str(rule)
    elif graph != "complete":
        graph = str(GraphRule.parse(graph).fitted_to(take(tracks, parts.train)))
    task = Task(
        title,
        tracks,
        parts,
        graph,
        tuple(int(k) for k in horizons),
        origins,
        free_steps,
        starts,
        draws,
        samples,
        seed,
    )
    if not (task.mask[:, 1:] & known(task.states)[:, :-1]).any():
        raise InputError(
            "tracks: in the test part nobody is seen in two consecutive frames; there is nothing "
            "to score."
        )
    return task


def _whole(states: Array) -> Array:
    """Return states that are known wholly or not at all."""
    return np.where(known(states)[..., None], states, np.nan)
