"""Other edges for a model that is ready-made, by name: ``swarmssm fit FILE --edges relational``."""

import inspect
from collections.abc import Mapping
from typing import Any, Literal, get_args

from swarmssm.errors import InputError
from swarmssm.models.base import SwarmModel
from swarmssm.models.edges import (
    DynamicRelationalEdges,
    InferredEdges,
    LatentEdges,
    ObservedEdges,
    RelationalEdges,
)
from swarmssm.models.presets.self_terms import check_choice
from swarmssm.models.pyro_modules import adopt
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.typed_forces import typed

__all__ = ["EDGES", "Laws", "with_edges"]

#: Edges whose types are inferred, by name.
EDGES: dict[str, type[InferredEdges]] = {
    "relational": RelationalEdges,
    "dynamic-relational": DynamicRelationalEdges,
}
Laws = Literal["own", "common"]


def with_edges(
    model: SwarmModel,
    scales: Scales,
    name: str,
    num_types: int | None = None,
    options: Mapping[str, Any] | None = None,
) -> StateSpaceModel:
    """Give a model other edges.

    Parameters
    ----------
    model
        A state-space model; changed in place.
    scales
        Of the training tracks.
    name
        ``"relational"`` (:class:`~swarmssm.models.RelationalEdges`), ``"dynamic-relational"``
        (:class:`~swarmssm.models.DynamicRelationalEdges`), ``"observed"``, or a rule such as
        ``"radius:2.5"``.
    num_types
        Of inferred edges, the one that is no edge included; absent, 2.
    options
        Of the constructor of inferred edges, ``no_edge``, ``sparsity`` and so on; and ``laws``,
        where more than one type acts: ``"own"``, each type has an interaction of its own
        (:func:`swarmssm.models.transitions.typed`, as in the original); ``"common"``, one
        interaction for all, times a learned strength of each. Absent, ``"own"``.

    Returns
    -------
    The model.

    Raises
    ------
    InputError
        If the model has no edges, the name is no rule, an option is unknown or out of range, or
        there are any for edges that are not inferred.
    """
    if not isinstance(model, StateSpaceModel):
        raise InputError(
            f"edges: {type(model).__name__} is no state-space model and has edges of its own; "
            "choose another model, for instance kernel."
        )
    given = dict(options or {})
    if name not in EDGES:
        if given or num_types is not None:
            raise InputError(
                f"edges: {name!r} has no types and no options; those are of {' and '.join(EDGES)}."
            )
        try:
            model.edges = ObservedEdges() if name == "observed" else LatentEdges(name)
        except InputError as error:
            raise InputError(
                f"edges: {name!r} is none of observed, {', '.join(EDGES)}, and no rule such as "
                f"radius:2.5 ({str(error).rstrip('.')})."
            ) from None
        return model
    laws = given.pop("laws", "own")
    check_choice("laws", laws, get_args(Laws))
    known = _options_of(EDGES[name])
    unknown = [option for option in given if option not in known]
    if unknown:
        raise InputError(
            f"edge_options: {unknown[0]} is no option of {name} edges. Choose among "
            f"{', '.join(['laws', *known])}."
        )
    edges = EDGES[name](
        scales, 2 if num_types is None else num_types, strengths=laws == "common", **given
    )
    model.edges = edges
    acting = edges.num_types - int(edges.no_edge)
    if laws == "own" and acting > 1:
        model.transition = typed(model.transition, acting, no_edge=edges.no_edge)
    adopt(model)
    return model


def _options_of(kind: type[InferredEdges]) -> list[str]:
    """Return the names of a constructor's options that a user may choose."""
    found = []
    for owner in (InferredEdges, kind):
        for name, parameter in inspect.signature(owner).parameters.items():
            if parameter.kind is parameter.KEYWORD_ONLY and name != "strengths":
                found.append(name)
    return found
