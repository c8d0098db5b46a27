"""Tracks: where each individual was at each time, as a validated xarray dataset."""

from swarmssm.tracks.dataset import (
    MAX_COORDINATE,
    MAX_FPS,
    MAX_JITTER,
    SPACE_NAMES,
    Array,
    has_trials,
    make_tracks,
    num_individuals,
    observed,
    spatial_attributes,
    states_of,
    stepwise_velocity,
    validate_tracks,
    with_trials,
)

__all__ = [
    "MAX_COORDINATE",
    "MAX_FPS",
    "MAX_JITTER",
    "SPACE_NAMES",
    "Array",
    "has_trials",
    "make_tracks",
    "num_individuals",
    "observed",
    "spatial_attributes",
    "states_of",
    "stepwise_velocity",
    "validate_tracks",
    "with_trials",
]
