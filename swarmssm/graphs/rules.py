"""Rules that make a graph from states, by name; and graphs as a part of tracks."""

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
import xarray as xr
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs.headings import headings_from_velocity
from swarmssm.graphs.neighbors import (
    complete_graph,
    k_nearest_graph,
    nearest_distances,
    radius_graph,
)
from swarmssm.graphs.visual import visual_field_graph
from swarmssm.tracks import has_trials, num_individuals, states_of, validate_tracks

__all__ = ["GraphRule", "add_adjacency", "body_length_of", "default_rule", "rule_of"]

#: Parameters of each kind of graph; the first is what a bare number after the colon means.
PARAMETERS = {
    "radius": ("radius", "box"),
    "k-nearest": ("k",),
    "visual": (
        "body_length",
        "body_width",
        "blind_angle",
        "eye_field",
        "eyes",
        "rays",
        "max_distance",
    ),
    "complete": (),
}
#: What must be given; a body length may be left to :meth:`GraphRule.fitted_to`.
REQUIRED = {"radius": "radius", "k-nearest": "k"}
WHOLE_NUMBERS = ("k", "eyes", "rays")
#: Up to this many individuals bodies are taken to hide each other, see :func:`default_rule`.
VISUAL_UP_TO = 100
DEFAULT_K = 6


@dataclasses.dataclass(frozen=True)
class GraphRule:
    """How the graph follows from positions and velocities, so that it can be made anew.

    Attributes
    ----------
    kind
        ``"radius"``, ``"k-nearest"``, ``"visual"`` or ``"complete"``.
    radius, box
        Of :func:`radius_graph`.
    k
        Of :func:`k_nearest_graph`.
    body_length, body_width, blind_angle, eye_field, eyes, rays, max_distance
        Of :func:`visual_field_graph`; its defaults hold for what is ``None``. A rule without
        ``body_length`` has to be fitted to tracks first (:meth:`fitted_to`).

    Raises
    ------
    InputError
        If the kind is unknown, a parameter it needs is absent, one is given that it does not have,
        or one is out of range.
    """

    kind: str
    radius: float | None = None
    box: float | None = None
    k: int | None = None
    body_length: float | None = None
    body_width: float | None = None
    blind_angle: float | None = None
    eye_field: float | None = None
    eyes: int | None = None
    rays: int | None = None
    max_distance: float | None = None

    def __post_init__(self) -> None:
        own = PARAMETERS[_check_kind(self.kind)]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "kind" or value is None:
                continue
            if field.name not in own:
                has = f"has {', '.join(own)}" if own else "has none"
                raise InputError(
                    f"graph: a {self.kind} graph has no parameter {field.name}; it {has}."
                )
            object.__setattr__(self, field.name, _number(field.name, value))
        required = REQUIRED.get(self.kind)
        if required and getattr(self, required) is None:
            raise InputError(f"graph: a {self.kind} graph needs {required}.")
        try:
            self._trial_run()
        except InputError as error:
            raise InputError(f"graph: {error}") from None

    def __call__(self, positions: Tensor, velocities: Tensor | None = None) -> Tensor:
        """Return the graph of each frame.

        Parameters
        ----------
        positions
            Shape ``(..., individual, space)``, NaN = absent.
        velocities
            Same shape; a visual graph takes the headings from it. Who rests or has no velocity
            then sees nobody in that frame (:func:`headings_from_velocity` fills such frames).

        Returns
        -------
        Shape ``(..., individual, individual)``, bool.

        Raises
        ------
        InputError
            If a visual graph has no body length or no velocities, or a shape is wrong.
        """
        parameters = self.parameters()
        if self.kind == "radius":
            return radius_graph(positions, **parameters)
        if self.kind == "k-nearest":
            return k_nearest_graph(positions, **parameters)
        if self.kind == "complete":
            return complete_graph(positions)
        if self.body_length is None:
            raise InputError(
                "graph: the body_length of the visual graph is not known. Give it, for instance "
                "visual:body_length=1.2, in the unit of the positions."
            )
        if velocities is None:
            raise InputError("velocities: a visual graph needs them to know where everyone looks.")
        return visual_field_graph(positions, velocities, **parameters)

    def parameters(self) -> dict[str, Any]:
        """Return the parameters that are given, by name."""
        values = {name: getattr(self, name) for name in PARAMETERS[self.kind]}
        return {name: value for name, value in values.items() if value is not None}

    def to_dict(self) -> dict[str, Any]:
        """Return the rule as a dictionary for JSON: ``{"kind": "radius", "radius": 2.5}``."""
        return {"kind": self.kind, **self.parameters()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "GraphRule":
        """Return the rule that :meth:`to_dict` described.

        Raises
        ------
        InputError
            Naming the field that is absent, unknown or out of range.
        """
        if not isinstance(values, Mapping):
            raise InputError(f"graph: a rule is a table of fields, not {values!r}.")
        if "kind" not in values:
            raise InputError("graph: the field kind is absent.")
        known = {field.name for field in dataclasses.fields(cls)}
        for name in values:
            if name not in known:
                raise InputError(f"graph: the field {name!r} is unknown.")
        return cls(**values)

    @classmethod
    def parse(cls, text: str) -> "GraphRule":
        """Return the rule that a user has typed.

        ``radius:2.5``, ``k-nearest:6``, ``visual``, ``visual:1.2``, ``complete``, or with names,
        ``visual:body_length=1.2,blind_angle=60``.

        Raises
        ------
        InputError
            Naming what cannot be read.
        """
        kind, _, rest = text.partition(":")
        kind = kind.strip()
        own = PARAMETERS[_check_kind(kind)]
        values: dict[str, Any] = {"kind": kind}
        for place, part in enumerate(filter(None, map(str.strip, rest.split(",")))):
            name, equals, value = part.partition("=")
            if not equals:
                if place > 0 or not own:
                    raise InputError(f"graph: {part!r} in {text!r} is not of the form name=value.")
                name, value = own[0], part
            if name.strip() in values:
                raise InputError(f"graph: {name.strip()} stands twice in {text!r}.")
            values[name.strip()] = value.strip()
        return cls.from_dict(values)

    def __str__(self) -> str:
        """Return the rule as :meth:`parse` reads it."""
        given = ",".join(f"{name}={value!r}" for name, value in self.parameters().items())
        return f"{self.kind}:{given}" if given else self.kind

    def fitted_to(self, tracks: xr.Dataset) -> "GraphRule":
        """Return the rule with a body length, for a visual graph that has none.

        It is :func:`body_length_of` the tracks.
        """
        if self.kind != "visual" or self.body_length is not None:
            return self
        return dataclasses.replace(self, body_length=body_length_of(tracks))

    def _trial_run(self) -> None:
        """Let the functions themselves refuse parameters that are out of range."""
        if self.kind != "visual" or self.body_length is not None:
            self(torch.zeros(1, 2), torch.zeros(1, 2))
        else:
            dataclasses.replace(self, body_length=1.0)


def body_length_of(tracks: xr.Dataset) -> float:
    """Return how long a body is, for the visual graph.

    It is ``attrs["body_length"]``, which some trackers measure. Else it is half the median
    distance to the nearest neighbour, over all individuals and frames: social animals keep one to a
    few body lengths apart.

    Parameters
    ----------
    tracks
        Tracks.

    Returns
    -------
    In the unit of the positions.

    Raises
    ------
    InputError
        If neither is to be had: no two individuals are ever seen in the same frame, or most lie at
        the very same place.
    """
    given = tracks.attrs.get("body_length")
    if given is not None:
        return float(_number("body_length", given))
    position = tracks["position"].transpose(..., "individual", "space").to_numpy()
    nearest = nearest_distances(torch.tensor(position))
    known = nearest[nearest.isfinite()].numpy()
    median = float(np.median(known)) if known.size else 0.0
    if median == 0.0:
        raise InputError(
            "tracks: no body length can be estimated from distances to the nearest neighbour. "
            "Give it, for instance visual:body_length=1.2, or choose another graph."
        )
    return 0.5 * median


def default_rule(tracks: xr.Dataset) -> GraphRule:
    """Return the graph for tracks of which nothing else is known.

    In the plane and up to 100 individuals it is the visual field (section 3.6 of the thesis), with
    :func:`body_length_of` the tracks. In larger groups, where the visual field is slow and a body
    length guessed from distances is least certain, in three dimensions, and for individuals that
    are never seen together, it is the 6 nearest neighbours.

    Parameters
    ----------
    tracks
        Tracks.
    """
    if tracks.sizes["space"] == 2 and num_individuals(tracks) <= VISUAL_UP_TO:
        try:
            return GraphRule("visual").fitted_to(tracks)
        except InputError:
            pass
    return GraphRule("k-nearest", k=DEFAULT_K)


def add_adjacency(tracks: xr.Dataset, rule: GraphRule, overwrite: bool = False) -> xr.Dataset:
    """Return the tracks with the graph of every frame.

    Parameters
    ----------
    tracks
        Tracks.
    rule
        How the graph follows from the states. A visual graph without body length is fitted to the
        tracks; headings come from the velocities, and who rests keeps the last one.
    overwrite
        Whether an ``adjacency`` that is there may be replaced.

    Returns
    -------
    A new dataset with ``adjacency ([trial,] time, individual, neighbor)`` of uint8, whose
    ``attrs["rule"]`` holds the rule as JSON; :func:`rule_of` reads it back.

    Raises
    ------
    InputError
        If there is an adjacency already and ``overwrite`` is false, if a visual graph is asked for
        in three dimensions, or if the tracks are none.
    """
    tracks = validate_tracks(tracks)
    if "adjacency" in tracks and not overwrite:
        raise InputError(
            "tracks: they have an adjacency already, and it was left as it is. Remove it first, or "
            "allow it to be overwritten."
        )
    rule = rule.fitted_to(tracks)
    states = torch.from_numpy(states_of(tracks))
    positions, velocities = states.chunk(2, dim=-1)
    if rule.kind == "visual":
        velocities = headings_from_velocity(velocities)
    edges = rule(positions, velocities).view(torch.uint8).numpy()
    dims: tuple[str, ...] = ("trial", "time", "individual", "neighbor")
    if not has_trials(tracks):
        edges, dims = edges[0], dims[1:]
    attrs = {"rule": json.dumps(rule.to_dict())}
    names = tracks["individual"].to_numpy()
    return (
        tracks.drop_vars(["adjacency", "neighbor"], errors="ignore")
        .assign_coords(neighbor=names)
        .assign(adjacency=(dims, edges, attrs))
    )


def rule_of(tracks: xr.Dataset) -> GraphRule | None:
    """Return the rule by which the tracks' adjacency was made, if it is known.

    Parameters
    ----------
    tracks
        Tracks.

    Returns
    -------
    The rule, or ``None`` where there is no adjacency or nothing is known of its making.

    Raises
    ------
    InputError
        If what stands there is not a rule.
    """
    text = tracks["adjacency"].attrs.get("rule") if "adjacency" in tracks else None
    if text is None:
        return None
    try:
        values = json.loads(text)
    except (TypeError, ValueError) as error:
        raise InputError(
            "tracks: the attribute rule of adjacency is not JSON. Remove it or make the graph anew."
        ) from error
    return GraphRule.from_dict(values)


def _check_kind(kind: str) -> str:
    """Return the kind of graph if there is such a kind."""
    if kind not in PARAMETERS:
        raise InputError(
            f"graph: the kind {kind!r} is unknown; choose one of {', '.join(PARAMETERS)}."
        )
    return kind


def _number(name: str, value: Any) -> float | int:
    """Return a parameter as a number, whole where it counts something."""
    whole = name in WHOLE_NUMBERS
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number) or (whole and number % 1):
        kind = "whole number" if whole else "number"
        raise InputError(f"graph: {name} must be a {kind}, not {value!r}.")
    return int(number) if whole else number
