"""A forecast and what was observed: how widely draws fan out, and whether they hold the truth."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks import Array, spatial_attributes, validate_tracks, with_trials

__all__ = ["fan_verdict", "forecast_fan"]

#: Draws at least; of fewer an interval says nothing.
FEWEST = 10
#: Frames of history that are kept for the pictures.
HISTORY = 50


def forecast_fan(
    forecast: xr.Dataset,
    tracks: xr.Dataset,
    *,
    levels: Sequence[float] = (0.5, 0.9),
    history: int = HISTORY,
) -> xr.Dataset:
    """Summarise the draws of a forecast, with what was observed.

    Parameters
    ----------
    forecast
        What :meth:`swarmssm.inference.Fit.forecast` returned, with draws.
    tracks
        Tracks that hold the history and, as far as it is known, what followed it; same trials.
    levels
        Shares of the draws that the intervals and ellipses hold, between 0 and 1.
    history
        Frames of history to keep.

    Returns
    -------
    Dataset with

    - ``draws (draw, trial, step, individual, space)``, ``median (trial, step, individual, space)``,
      ``low`` and ``high (level, ...)``: ends of the central interval of each coordinate;
    - ``center (trial, step, individual, plane)``, ``covariance (..., plane, axis)`` of the draws
      in the first two coordinates, and ``reach (level, trial, step, individual)``: the ellipse
      ``(x - center)' covariance^-1 (x - center) <= reach^2`` holds that share of the draws;
    - ``observed (trial, step, individual, space)``: positions, NaN where unknown; ``inside (level,
      trial, step, individual)``: 1 where the ellipse holds it, 0 where not, NaN where unknown;
    - ``history (trial, before, individual, space)`` up to the frame from which the forecast goes
      on;

    and ``ahead (step)``, ``behind (before)`` in seconds from there, ``start (trial)``. Who is not
    forecast is NaN.

    Raises
    ------
    InputError
        If there are fewer than 10 draws, the trials or individuals of the two are not the same, a
        level is out of range, or the tracks do not hold the history.

    Notes
    -----
    An ellipse of a crescent of draws is wider than the crescent; and the individuals of a frame
    move together, so that 80 of them are not 80 independent proofs.
    """
    if "position" not in forecast or "draw" not in forecast["position"].dims:
        raise InputError("forecast: it has no draws. Make it with draws=100 or so.")
    if forecast.sizes["draw"] < FEWEST:
        raise InputError(
            f"forecast: {forecast.sizes['draw']} draws are too few for an interval; draw at least "
            f"{FEWEST}."
        )
    if not levels or any(not 0.0 < level < 1.0 for level in levels):
        raise InputError("levels: each must lie between 0 and 1, and there must be one.")
    if history < 1:
        raise InputError(f"history: it must be at least 1, and it is {history}.")
    tracks = with_trials(validate_tracks(tracks))
    for name in ("trial", "individual"):
        ours, theirs = ([str(one) for one in data[name].values] for data in (tracks, forecast))
        if ours != theirs:
            raise InputError(
                f"tracks: each {name} must be one of the forecast's, in its order; they are "
                f"{', '.join(ours[:5])} and {', '.join(theirs[:5])}."
            )
    fps = float(tracks.attrs["fps"])
    order = ("draw", "trial", "time", "individual", "space")
    draws = forecast["position"].transpose(*order).to_numpy()
    rows = _rows(tracks, forecast["history_end"].to_numpy())
    path = tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    steps = draws.shape[2]
    padded = np.pad(path, ((0, 0), (history, steps), (0, 0), (0, 0)), constant_values=np.nan)
    before = np.stack([padded[k, row + 1 : row + 1 + history] for k, row in enumerate(rows)])
    observed = np.stack(
        [padded[k, row + 1 + history : row + 1 + history + steps] for k, row in enumerate(rows)]
    )
    sides = [(1 - level) / 2 for level in levels] + [(1 + level) / 2 for level in levels] + [0.5]
    with np.errstate(invalid="ignore"):
        quantiles = np.quantile(draws, sides, axis=0)
    center, covariance, reach, inside = _ellipses(draws[..., :2], observed[..., :2], levels)
    one = ("trial", "step", "individual")
    count = len(levels)
    unit = {"units": str(tracks.attrs.get("unit", ""))}
    return xr.Dataset(
        {
            "draws": (("draw", *one, "space"), draws, unit),
            "median": ((*one, "space"), quantiles[-1], unit),
            "low": (("level", *one, "space"), quantiles[:count], unit),
            "high": (("level", *one, "space"), quantiles[count:-1], unit),
            "center": ((*one, "plane"), center, unit),
            "covariance": ((*one, "plane", "axis"), covariance),
            "reach": (("level", *one), reach),
            "observed": ((*one, "space"), observed, unit),
            "inside": (("level", *one), inside),
            "history": (("trial", "before", "individual", "space"), before, unit),
        },
        {
            "trial": tracks["trial"].to_numpy(),
            "individual": tracks["individual"].to_numpy(),
            "space": tracks["space"].to_numpy(),
            "level": list(levels),
            "step": np.arange(1, steps + 1),
            "ahead": ("step", np.arange(1, steps + 1) / fps, {"units": "s"}),
            "behind": ("before", np.arange(1 - history, 1) / fps, {"units": "s"}),
            "start": ("trial", forecast["history_end"].to_numpy(), {"units": "s"}),
        },
        {**spatial_attributes(tracks), "fps": fps},
    )


def fan_verdict(fan: xr.Dataset) -> str:
    """Return in one line how often the widest ellipse holds an observation."""
    level = float(fan["level"].max())
    inside = fan["inside"].sel(level=level)
    count = int(inside.notnull().sum())
    if not count:
        return "No position was observed: the tracks end where the forecast begins."
    share = float(inside.mean())
    last = inside.isel(step=-1)
    text = (
        f"Of {count} observed positions, {100 * share:.0f} % lay inside the ellipse that should "
        f"hold {100 * level:.0f} %"
    )
    if last.notnull().any() and inside.sizes["step"] > 1:
        text += (
            f" ({100 * float(last.mean()):.0f} % at the last step, "
            f"{float(fan['ahead'][-1]):.3g} s ahead)"
        )
    starts = fan.sizes["trial"]
    which = "one start" if starts == 1 else f"{starts} starts"
    return (
        f"{text}; from {which} alone this is weak evidence, since individuals and steps of a run "
        "are not independent."
    )


def _rows(tracks: xr.Dataset, ends: Array) -> list[int]:
    """Return the row of each trial from which the forecast goes on."""
    stamps = tracks["time"].to_numpy()
    rows = [int(np.argmin(np.abs(stamps - end))) for end in ends]
    far = np.abs(stamps[rows] - ends) > 0.5 / float(tracks.attrs["fps"])
    if far.any():
        raise InputError(
            f"tracks: the forecast goes on from {ends[far][0]:g} s, and they run from "
            f"{stamps[0]:g} s to {stamps[-1]:g} s. Give the tracks that it was made of, whole."
        )
    return rows


def _ellipses(
    draws: Array, observed: Array, levels: Sequence[float]
) -> tuple[Array, Array, Array, Array]:
    """Return centers, covariances, reach of each level, and whether it holds the observation."""
    center = draws.mean(axis=0)
    away = draws - center
    covariance = np.einsum("d...i,d...j->...ij", away, away) / (len(draws) - 1)
    # Draws that all but agree would have no inverse: a billionth of the variance keeps it.
    tiny = 1e-9 * np.trace(covariance, axis1=-2, axis2=-1)[..., None, None] + 1e-30
    known = np.isfinite(covariance).all(axis=(-1, -2))
    inverse = np.full(covariance.shape, np.nan)
    inverse[known] = np.linalg.inv((covariance + tiny * np.eye(2))[known])
    distance = np.sqrt(np.einsum("d...i,...ij,d...j->d...", away, inverse, away))
    # Of one more draw than there are: what comes is not among those that made the ellipse.
    shares = np.minimum(np.asarray(levels) * (len(draws) + 1) / len(draws), 1.0)
    with np.errstate(invalid="ignore"):
        reach = np.quantile(distance, shares, axis=0)
    off = observed - center
    far = np.sqrt(np.einsum("...i,...ij,...j->...", off, inverse, off))
    inside = np.where(np.isfinite(far) & np.isfinite(reach), far <= reach, np.nan)
    return center, covariance, reach, inside.astype(np.float64)
