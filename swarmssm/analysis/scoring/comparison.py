"""Which of several fits is best, by how much, and how surely."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring.fairness import (
    check_future,
    check_same_scales,
    held_out_frames,
    seen_frames,
)
from swarmssm.analysis.scoring.forecast_ranking import by_forecasts
from swarmssm.analysis.scoring.ranking import NOISE_FLOOR
from swarmssm.analysis.scoring.rolling_origin import HORIZONS
from swarmssm.analysis.scoring.table import format_number
from swarmssm.analysis.scoring.window_ranking import by_windows
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import validate_tracks

__all__ = ["METHODS", "Comparison", "compare"]

METHODS = ("held-out", "lfo", "loo")
#: Differences of so many standard errors are more than chance.
SURE = 2.0
#: With a greater share of windows that cannot be left out by weights, a ranking is not one.
DOUBT = 0.1
DESCRIPTIONS = {
    "held-out": "log score of forecasts of held-out frames",
    "loo": "leave-one-out density of the frames that all were trained on",
    "lfo": "density of held-out frames, each from those before",
}


@dataclass(frozen=True)
class Comparison:
    """Fits in the order of their scores.

    Attributes
    ----------
    data
        Dataset over ``model``, best first:

        - ``score`` and its ``se``: of ``"held-out"`` the mean log score in nats per coordinate,
          else the sum of the windows' expected log predictive densities in nats (elpd); higher is
          better;
        - ``difference``: how much worse than the best, and ``difference_se``, its standard error
          from pairs on the same origins or windows; NaN where it cannot be estimated;
        - ``rank``, from 1; 0 of the true rule, which has none; ``fitted``: whether it is a fit;
        - of ``"held-out"``: ``log_score (model, horizon)``; else ``elpd (model, window)``,
          ``pareto_k (model, window)``, ``believed (model, window)`` and ``effective_parameters
          (model)`` (of ``"loo"``).

        ``attrs["notes"]`` is what a reader has to know, the Pareto k in words among it.
    """

    data: xr.Dataset

    @property
    def notes(self) -> list[str]:
        """What a reader has to know."""
        return [str(note) for note in self.data.attrs["notes"]]

    def summary(self) -> pd.DataFrame:
        """Return a row a model, best first: rank, score and difference with standard errors."""
        columns = ["rank", "fitted", "score", "se", "difference", "difference_se"]
        frame = self.data[columns].to_dataframe()[columns]
        if "log_score" in self.data:
            for k in self.data["horizon"].values:
                frame[f"log_score_{k}"] = self.data["log_score"].sel(horizon=k).to_numpy()
        else:
            frame["windows_believed"] = self.data["believed"].sum("window").to_numpy()
        if "effective_parameters" in self.data:
            frame["effective_parameters"] = self.data["effective_parameters"].to_numpy()
        return frame

    def rows(self) -> list[dict[str, str]]:
        """Return the table as people read it: one row a model, column title to text."""
        held_out = self.data.attrs["method"] == "held-out"
        score = "log score" if held_out else "elpd"
        rows = []
        for name in map(str, self.data["model"].values):
            own = self.data.sel(model=name)
            rank = int(own["rank"])
            best = rank == 1
            row = {
                "rank": str(rank) if rank else "–",
                "model": name,
                score: _pair(own["score"], own["se"]),
                "behind the best": "–" if best else _pair(own["difference"], own["difference_se"]),
                "in standard errors": "–" if best else _ratio(own),
            }
            if held_out:
                for k in self.data["horizon"].values:
                    row[f"{k} ahead"] = format_number(float(own["log_score"].sel(horizon=k)))
            else:
                believed = own["believed"].to_numpy()
                row["windows believed"] = f"{int(believed.sum())} of {believed.size}"
            if "effective_parameters" in self.data:
                row["effective parameters"] = format_number(float(own["effective_parameters"]))
            rows.append(row)
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, models in the order of their ranks."""
        settings = {name: value for name, value in self.data.attrs.items() if name != "notes"}
        models = []
        for name in map(str, self.data["model"].values):
            own = self.data.sel(model=name)
            row: dict[str, Any] = {"model": name}
            for variable in ("rank", "fitted", "score", "se", "difference", "difference_se"):
                row[variable] = own[variable].item()
            if "log_score" in own:
                values = own["log_score"].to_series()
                row["log_score"] = {str(k): float(value) for k, value in values.items()}
            else:
                row |= {v: own[v].to_numpy().tolist() for v in ("elpd", "pareto_k", "believed")}
            if "effective_parameters" in own:
                row["effective_parameters"] = own["effective_parameters"].item()
            models.append(row)
        found = {"settings": settings, "models": models}
        if "window" in self.data.dims:
            found["windows"] = [
                {name: self.data[name].isel(window=k).item() for name in ("trial", "start", "stop")}
                for k in range(self.data.sizes["window"])
            ]
        return found | {"verdict": self.verdict(), "notes": self.notes}

    def verdict(self) -> str:
        """Return which model is best, and whether the data tell it from the others."""
        names = [str(n) for n in self.data["model"].values if str(n) != NOISE_FLOOR]
        best, rest = names[0], names[1:]
        units = "nats a coordinate" if self.data.attrs["method"] == "held-out" else "nats"
        text = (
            f"By the {DESCRIPTIONS[self.data.attrs['method']]}, {best} is first with "
            f"{format_number(float(self.data['score'].sel(model=best)))} {units}"
        )
        if rest:
            second = self.data.sel(model=rest[0])
            error = float(second["difference_se"])
            spread = f"standard error {format_number(error)}"
            text += (
                f", {format_number(float(second['difference']))} "
                f"({'no standard error' if math.isnan(error) else spread}) before {rest[0]}"
            )
        text += ". "
        unknown = [
            name for name in rest if math.isnan(float(self.data["difference_se"].sel(model=name)))
        ]
        close = [name for name in rest if name not in unknown and not _is_behind(self.data, name)]
        if unknown:
            text += f"{joined(unknown)} without standard error: this is an order, not a finding."
        elif close:
            verb = "are" if len(close) > 1 else "is"
            text += (
                f"{joined(close)} {verb} not behind by {SURE:g} standard errors: these data do not "
                "tell which is better."
            )
        elif rest:
            text += "All others are behind by more than two standard errors."
        fitted = [n for n in names if bool(self.data["fitted"].sel(model=n))]
        beaten = [n for n in fitted if names.index(n) > _place(names, "constant-velocity")]
        if beaten:
            have = "do" if len(beaten) > 1 else "does"
            text += f" {joined(beaten)} {have} not forecast better than constant velocity."
        if "believed" in self.data:
            doubtful = int((~self.data["believed"]).any("model").sum())
            count = self.data.sizes["window"]
            if doubtful:
                text += f" In {doubtful} of {count} windows the weights cannot be believed"
                much = self.data.attrs["method"] == "loo" and doubtful > DOUBT * count
                text += ": read no ranking from it, and take another method." if much else "."
        return text


def compare(
    fits: Mapping[str, Fit],
    tracks: xr.Dataset,
    *,
    method: str = "held-out",
    part: str | None = None,
    horizons: Sequence[int] = HORIZONS,
    origins: int = 40,
    draws: int | None = None,
    window: int | None = None,
    allow_seen: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    r"""Rank fits by how probable they make what they have not seen, on the same frames.

    * ``"held-out"``: forecasts from many held-out frames
      (:func:`swarmssm.analysis.scoring.score`), by the log score of an individual's position,
      averaged over the horizons; staying put, constant velocity and, of simulated tracks, the true
      rule are scored too. The question of a forecaster, fair to any kind of model. With the
      standard errors of a moving-block bootstrap.
    * ``"lfo"``: leave-future-out. The held-out frames in the order of time, window by window: each
      by the joint log-density that the frames before give it, one step ahead of another, and by
      parameters that have learned from the windows before (PSIS-LFO). Exact refits are too dear:
      where the weights can no longer be believed, the parameters stop learning there.
    * ``"loo"``: leave-one-out of trials or windows of the *training* frames, by weighting the
      draws of the posterior (PSIS-LOO). Uses all data, and needs fits whose every parameter has a
      posterior (``boids``, ``kernel``, ``linear``), all trained on the same frames.

    Held-out frames of a fit are its test part (else its validation part) of its own tracks, and all
    of any others. A fit that was trained on frames to be scored by ``"held-out"`` or ``"lfo"`` is
    refused, unless ``allow_seen`` says that this is meant. For ``"loo"`` the very point is that
    the frames were seen, so that the reverse is refused: a fit that was not trained on them, or on
    others too.

    Parameters
    ----------
    fits
        Name -> fit, at least two.
    tracks
        What they are judged on.
    method
        See above.
    part
        Of ``"held-out"`` and ``"lfo"``: see :func:`swarmssm.analysis.scoring.score`.
    horizons, origins
        Of ``"held-out"``, likewise.
    draws
        Sampled futures of each origin, or of the parameters. Absent: 100 futures, 400 parameters.
    window
        Frames in a window of ``"loo"`` and ``"lfo"``. Absent: whole trials if there are at least
        ten, else about thirty windows of at least ten frames.
    allow_seen
        See above.
    seed
        Of all draws.
    progress
        Called with what is being done, in words.

    Raises
    ------
    InputError
        If there are fewer than two fits, an argument is unknown, out of range or of no use to the
        method, or the fits cannot be compared on these tracks.
    """
    tracks = validate_tracks(tracks)
    _check(fits, method, part, window, allow_seen, draws)
    check_same_scales(fits, tracks)
    if method == "held-out":
        return Comparison(
            by_forecasts(
                fits, tracks, part, horizons, origins, draws or 100, allow_seen, seed, progress
            )
        )
    notes: list[str] = []
    if method == "loo":
        segments, name = seen_frames(fits, tracks), "train"
    else:
        frames = held_out_frames(fits, tracks, part, allow_seen=allow_seen)
        if not allow_seen:
            check_future(fits, tracks, frames)
        segments, name, notes = frames.segments, frames.part, [*frames.notes]
    return Comparison(
        by_windows(
            fits, tracks, method, segments, name, draws or 400, window, seed, progress, notes
        )
    )


def _check(
    fits: Mapping[str, Fit],
    method: str,
    part: str | None,
    window: int | None,
    allow_seen: bool,
    draws: int | None,
) -> None:
    """Refuse arguments that say nothing."""
    if method not in METHODS:
        raise InputError(f"method: {method!r} is unknown; choose one of {', '.join(METHODS)}.")
    if len(fits) < 2:
        raise InputError("fits: at least two are needed to be compared.")
    if method == "loo" and part is not None:
        raise InputError("part: leave-one-out is of the training part; leave the part away.")
    if method == "loo" and allow_seen:
        raise InputError(
            "allow_seen: leave-one-out is of frames that the fits have seen; leave it away."
        )
    if method == "held-out" and window is not None:
        raise InputError("window: method held-out has no windows; it has horizons and origins.")
    if draws is not None and draws < 100 and method != "held-out":
        raise InputError(
            f"draws: weights of fewer than 100 draws say nothing, and these are {draws}."
        )


def _place(names: list[str], name: str) -> int:
    """Return where a name stands, behind all if it does not."""
    return names.index(name) if name in names else len(names)


def _is_behind(result: xr.Dataset, name: str) -> bool:
    """Return whether a model is surely behind the best."""
    own = result.sel(model=name)
    difference, error = float(own["difference"]), float(own["difference_se"])
    if math.isinf(difference):
        return True
    return math.isfinite(error) and difference > SURE * error


def _pair(value: xr.DataArray, error: xr.DataArray) -> str:
    """Return a number with its standard error."""
    own = format_number(float(error), 2)
    return (
        f"{format_number(float(value), 4)} ± {own}" if own != "–" else format_number(value.item())
    )


def _ratio(own: xr.Dataset) -> str:
    """Return how many standard errors a difference is."""
    error = float(own["difference_se"])
    if not np.isfinite(error) or error == 0:
        return "–"
    return f"{float(own['difference']) / error:.1f}"
