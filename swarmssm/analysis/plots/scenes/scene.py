"""Frames ready to be drawn: where everyone is and looks, and who sees whom."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import numpy.typing as npt
import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule, headings_from_velocity
from swarmssm.tracks import Array, spatial_attributes, states_of, validate_tracks, with_trials

__all__ = [
    "FLAT",
    "Box",
    "Choice",
    "Scene",
    "box_of",
    "decimals_of",
    "one_trial",
    "pace_of",
    "row_at",
    "scenes_of",
]

Mask = npt.NDArray[np.bool_]
Box = tuple[float, float, float, float]

FLAT = "Positions are seen from above: z is not shown."
#: The box grows for a prediction by at most so many sides of that of the observed positions.
ROOM = 0.5
#: Frames per second that are shown, where those of the recording would be a still or a blur.
SLOWEST, USUAL, FASTEST = 4.0, 25.0, 60.0
#: A time belongs to a frame if it is no further off than this share of the time between frames.
NEAR = 0.5 + 1e-6


@dataclass(frozen=True)
class Scene:
    """Consecutive or regularly thinned frames of one trial.

    Attributes
    ----------
    time
        Seconds ``(time,)``.
    position
        The first two coordinates ``(time, individual, 2)``, NaN where nobody was tracked.
    heading
        Radians from the first axis towards the second ``(time, individual)``: of the last motion,
        NaN before the first.
    adjacency
        ``(time, individual, individual)``: i sees j; or None where no graph is known.
    individuals
        Labels.
    trial
        Label.
    unit
        Of length.
    space
        Names of the two coordinates.
    flat
        Whether a third coordinate was left out.
    rate
        Frames per second of the recording that are in the scene.
    y_axis
        ``"down"`` where the second coordinate grows downwards in the picture.
    """

    time: Array
    position: Array
    heading: Array
    adjacency: Mask | None
    individuals: tuple[str, ...]
    trial: str
    unit: str
    space: tuple[str, str]
    flat: bool
    rate: float
    y_axis: str = "up"


class Choice(TypedDict, total=False):
    """What of tracks is shown: the options of :func:`scenes_of`."""

    trial: str | None
    individuals: Sequence[str] | None
    start: float | None
    steps: int | None
    every: int
    edges: bool | str | GraphRule
    predicted_start: float | None


def scenes_of(
    tracks: xr.Dataset,
    predicted: xr.Dataset | None = None,
    *,
    trial: str | None = None,
    individuals: Sequence[str] | None = None,
    start: float | None = None,
    steps: int | None = None,
    every: int = 1,
    edges: bool | str | GraphRule = True,
    predicted_start: float | None = None,
) -> list[Scene]:
    """Return the frames of tracks, and those of a prediction at the same times.

    Parameters
    ----------
    tracks
        Tracks.
    predicted
        Tracks too, for instance ``free_run``. Its individuals may be
        others.
    trial
        Label; default the first. A prediction with one trial goes with any.
    individuals
        Labels of those to show; default all. Others of a prediction are left out too.
    start
        Seconds: the first frame is the last that is not later. Default: the first frame.
    steps
        Number of steps between frames from there; default all. Fewer, if there are fewer.
    every
        Keep each so many-th frame.
    edges
        Whether to keep the graph that the tracks carry; or the rule that makes one, as
        :meth:`swarmssm.graphs.GraphRule.parse` reads it, of both.
    predicted_start
        Seconds of the tracks at which the first frame of the prediction is. Default: the
        prediction's own times are those of the tracks.

    Returns
    -------
    One scene, or two of the same length: where the prediction has no frame near a time, all of it
    is NaN there.

    Raises
    ------
    InputError
        If a label is unknown, a time lies outside, a number is out of range, the prediction has no
        frame in common with the tracks, or a graph cannot be made.
    """
    if every < 1:
        raise InputError(f"every: it must be at least 1, and it is {every}.")
    if steps is not None and steps < 1:
        raise InputError(f"steps: it must be at least 1, and it is {steps}.")
    tracks = one_trial(_checked(tracks, "tracks"), trial, "tracks")
    rows = _rows(tracks, start, steps)
    rule = GraphRule.parse(edges) if isinstance(edges, str) else edges
    chosen = _members(tracks, individuals)
    observed = _scene(tracks, rows, every, chosen, rule)
    if predicted is None:
        return [observed]
    other = _checked(predicted, "predicted")
    if other.sizes["trial"] > 1:
        other = one_trial(other, observed.trial, "predicted")
    shift = 0.0 if predicted_start is None else predicted_start - float(other["time"][0])
    other = other.assign_coords(time=other["time"] + shift)
    places = _nearest(other["time"].to_numpy(), tracks["time"].to_numpy()[rows])
    if (places < 0).all():
        first, last = float(other["time"][0]), float(other["time"][-1])
        raise InputError(
            f"predicted: its times, {first:g} s to {last:g} s, have none in common with the frames "
            "to show. Say with predicted_start at which time of the tracks it begins."
        )
    shown = None if individuals is None else set(observed.individuals)
    members = [
        place
        for place, name in enumerate(other["individual"].values)
        if shown is None or str(name) in shown
    ]
    if not members:
        raise InputError(
            f"predicted: it has none of the individuals {', '.join(observed.individuals[:5])}. "
            "Choose others, or show all."
        )
    return [observed, _scene(other, places, every, members, rule, observed.time)]


def box_of(scenes: Sequence[Scene]) -> tuple[Box, bool]:
    """Return the box to draw, ``(left, right, bottom, top)``, and whether anyone leaves it.

    It holds all of the first scene, and of the others as much as lies within half its longer side.
    Neither side is shorter than 0.4 of the other.
    """
    corners = []
    for scene in scenes:
        known = scene.position[np.isfinite(scene.position).all(axis=-1)]
        if len(known):
            corners.append((known.min(axis=0), known.max(axis=0)))
    if not corners:
        return (0.0, 1.0, 0.0, 1.0), False
    low, high = corners[0]
    room = ROOM * max(float((high - low).max()), 1e-9)
    whole_low = np.min([one for one, _ in corners], axis=0)
    whole_high = np.max([one for _, one in corners], axis=0)
    least, most = low - room, high + room
    leaves = bool((whole_low < least).any() or (whole_high > most).any())
    low, high = np.maximum(whole_low, least), np.minimum(whole_high, most)
    side = max(float((high - low).max()), 1e-9)
    middle = (low + high) / 2
    half = np.maximum(high - low, 0.4 * side) / 2 + 0.05 * side
    (left, bottom), (right, top) = middle - half, middle + half
    return (float(left), float(right), float(bottom), float(top)), leaves


def pace_of(scene: Scene, fps_out: float | None, fastest: float = FASTEST) -> float:
    """Return how many frames of a scene to show a second.

    Parameters
    ----------
    scene
        The scene.
    fps_out
        What the user asks for. Default: as it was, if that is 4 to ``fastest`` frames a second;
        else 25 for what is slower, and ``fastest``.
    fastest
        The most by default.

    Raises
    ------
    InputError
        If ``fps_out`` is not a positive number.
    """
    if fps_out is not None:
        if not 0.0 < fps_out < np.inf:
            raise InputError(f"fps_out: it must be a positive number, and it is {fps_out:g}.")
        return float(fps_out)
    return USUAL if scene.rate < SLOWEST else min(scene.rate, fastest)


def decimals_of(scene: Scene) -> int:
    """Return how many decimals tell the time of one frame from that of the next."""
    return int(np.clip(np.ceil(np.log10(scene.rate)), 0, 6))


def _checked(tracks: xr.Dataset, where: str) -> xr.Dataset:
    """Return tracks with trials, one path each."""
    if "position" in tracks and "draw" in tracks["position"].dims:
        raise InputError(
            f"{where}: it holds {tracks.sizes['draw']} draws, and one path is to be shown. Take "
            "one of them with .isel(draw=0)."
        )
    return with_trials(validate_tracks(tracks, where))


def one_trial(tracks: xr.Dataset, trial: str | None, where: str) -> xr.Dataset:
    """Return the trial of that label, or the first, as tracks with one trial.

    Raises
    ------
    InputError
        If there is no such trial; ``where`` names the tracks in the sentence.
    """
    labels = [str(label) for label in tracks["trial"].values]
    if trial is None:
        return tracks.isel(trial=[0])
    if str(trial) not in labels:
        named = ", ".join(labels[:8]) + (", ..." if len(labels) > 8 else "")
        raise InputError(f"{where}: there is no trial {str(trial)!r}; there are {named}.")
    return tracks.isel(trial=[labels.index(str(trial))])


def _rows(tracks: xr.Dataset, start: float | None, steps: int | None) -> npt.NDArray[np.int64]:
    """Return the consecutive rows to show; without an end, up to the last with anybody in it."""
    stamps = tracks["time"].to_numpy()
    seen = np.flatnonzero(tracks["position"].notnull().any(("trial", "space", "individual")))
    if not seen.size:
        raise InputError(f"tracks: in trial {tracks['trial'].values[0]} nobody is ever tracked.")
    first = 0 if start is None else row_at(tracks, start)
    if first > seen[-1]:
        raise InputError(
            f"start: nobody is tracked after {stamps[seen[-1]]:g} s. Start before that."
        )
    last = int(seen[-1]) if steps is None else min(first + steps, len(stamps) - 1)
    return np.arange(first, last + 1)


def row_at(tracks: xr.Dataset, start: float) -> int:
    """Return the last row that is not later than a time.

    Raises
    ------
    InputError
        If the time lies outside of the tracks.
    """
    stamps = tracks["time"].to_numpy()
    slack = 1e-6 / float(tracks.attrs["fps"])
    if not stamps[0] - slack <= start <= stamps[-1] + slack:
        raise InputError(
            f"start: {start:g} s lies outside of the tracks, which run from {stamps[0]:g} s to "
            f"{stamps[-1]:g} s."
        )
    return int(np.searchsorted(stamps, start + slack, side="right")) - 1


def _members(tracks: xr.Dataset, individuals: Sequence[str] | None) -> list[int]:
    """Return the places of the named individuals, in the order of the tracks."""
    labels = [str(name) for name in tracks["individual"].values]
    if individuals is None:
        return list(range(len(labels)))
    wanted = [str(name) for name in individuals]
    unknown = [name for name in wanted if name not in labels]
    if unknown or not wanted:
        named = ", ".join(labels[:10]) + (", ..." if len(labels) > 10 else "")
        said = f"there is no {unknown[0]!r}" if unknown else "none is named"
        raise InputError(f"individuals: {said}; there are {named}.")
    return [place for place, name in enumerate(labels) if name in wanted]


def _nearest(stamps: Array, wanted: Array) -> npt.NDArray[np.int64]:
    """Return the row that is nearest to each wanted time, -1 where none is near."""
    gap = float(np.median(np.diff(stamps))) if len(stamps) > 1 else np.inf
    if not np.isfinite(gap):
        gap = float(np.median(np.diff(wanted))) if len(wanted) > 1 else 1.0
    after = np.clip(np.searchsorted(stamps, wanted), 1, max(len(stamps) - 1, 1))
    before = np.minimum(after - 1, len(stamps) - 1)
    after = np.minimum(after, len(stamps) - 1)
    nearer = np.where(wanted - stamps[before] <= stamps[after] - wanted, before, after)
    near = np.abs(stamps[nearer] - wanted) <= NEAR * gap
    return np.where(near, nearer, -1)


def _scene(
    tracks: xr.Dataset,
    rows: npt.NDArray[np.int64],
    every: int,
    members: list[int],
    rule: bool | GraphRule,
    time: Array | None = None,
) -> Scene:
    """Take rows (-1 for none) of the only trial; headings and graphs know what went before."""
    states = torch.from_numpy(states_of(tracks)[0])
    position, velocity = states.chunk(2, dim=-1)
    headings = headings_from_velocity(velocity[..., :2])
    rows = rows[::every]
    edges = _edges(tracks, position, velocity, rows, rule)
    absent = rows < 0
    place = position.numpy()[rows][..., :2].copy()
    angle = torch.atan2(headings[..., 1], headings[..., 0]).numpy()[rows].copy()
    place[absent] = np.nan
    angle[absent] = np.nan
    unknown = ~np.isfinite(place).all(axis=-1)
    place[unknown] = np.nan
    angle[unknown] = np.nan
    if edges is not None:
        edges = edges & ~unknown[:, :, None] & ~unknown[:, None, :]
        edges &= ~np.eye(edges.shape[-1], dtype=bool)
        edges = edges[:, members][:, :, members]
    names = [str(name) for name in tracks["space"].values]
    return Scene(
        tracks["time"].to_numpy()[rows] if time is None else time,
        place[:, members],
        angle[:, members],
        edges,
        tuple(str(tracks["individual"].values[place]) for place in members),
        str(tracks["trial"].values[0]),
        str(tracks.attrs.get("unit", "")),
        (names[0], names[1]),
        len(names) > 2,
        float(tracks.attrs["fps"]) / every,
        spatial_attributes(tracks).get("y_axis", "up"),
    )


def _edges(
    tracks: xr.Dataset,
    position: torch.Tensor,
    velocity: torch.Tensor,
    rows: npt.NDArray[np.int64],
    rule: bool | GraphRule,
) -> Mask | None:
    """Return the graphs of the rows, or None where none is wanted or known."""
    if isinstance(rule, GraphRule):
        rule = rule.fitted_to(tracks)
        looks = headings_from_velocity(velocity) if rule.kind == "visual" else velocity
        made: Mask = rule(position[rows], looks[rows]).numpy().astype(bool)
        return made
    if not rule or "adjacency" not in tracks:
        return None
    order = ("trial", "time", "individual", "neighbor")
    graphs = tracks["adjacency"].transpose(*order).to_numpy()[0, rows]
    known: Mask = graphs.astype(bool)
    return known
