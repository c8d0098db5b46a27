"""Which runs may be judged on which frames, and the reasons why not."""

from collections.abc import Mapping

import xarray as xr

from swarmssm.analysis.posterior.frames import ScoredFrames, common_frames, same_tracks
from swarmssm.analysis.posterior.joining import joined
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.data import prepare
from swarmssm.models import StateSpaceModel
from swarmssm.models.parameters import priors_of
from swarmssm.models.scales import Scales, scales_of
from swarmssm.tracks.splits import Segment

__all__ = ["check_future", "check_same_scales", "held_out_frames", "seen_frames"]

#: A unit of length is another one if sizes differ by more than this factor.
FACTOR = 10.0
#: Frame rates that differ by less than this part are one.
SAME_RATE = 0.01


def check_same_scales(fits: Mapping[str, Fit], tracks: xr.Dataset) -> None:
    """Refuse runs that were fitted on tracks of another kind than those to be judged on.

    Raises
    ------
    InputError
        If number of dimensions, frame rate or unit of length differ, naming the runs.
    """
    fps = float(tracks.attrs["fps"])
    space = tracks.sizes["space"]
    own: Scales | None = None
    for name, fit in fits.items():
        scales = fit.scales
        if scales.space != space:
            raise InputError(
                f"{name}: it was fitted on tracks of {scales.space} coordinates, and these have "
                f"{space}; the two cannot be compared."
            )
        rate = 1.0 / scales.dt
        if abs(rate - fps) > SAME_RATE * fps:
            raise InputError(
                f"{name}: it was fitted on {rate:g} frames a second, and these tracks have "
                f"{fps:g}. Its steps are of another length: compare on tracks of its rate."
            )
        if same_tracks(fit, tracks):
            continue
        if own is None:
            own = scales_of(prepare(tracks, fit.preparation).tracks)
        for what, theirs, here in (
            ("spread over", scales.length, own.length),
            ("move at", scales.speed, own.speed),
        ):
            low, high = sorted((theirs, here))
            if low > 0 and high > FACTOR * low:
                raise InputError(
                    f"{name}: its animals {what} {theirs:.3g} units of length"
                    f"{'' if what == 'spread over' else ' a second'}, those of these tracks "
                    f"{here:.3g}. The units differ: write both in the same one (swarmssm import)."
                )


def held_out_frames(
    fits: Mapping[str, Fit], tracks: xr.Dataset, part: str | None, *, allow_seen: bool
) -> ScoredFrames:
    """Return frames that none of the fits was trained on.

    Raises
    ------
    InputError
        If one was, and that is not allowed; or there are none in common.
    """
    frames = common_frames(fits, tracks, part)
    seen = [name for name, number in frames.trained_on.items() if number]
    if seen and not allow_seen:
        verb = "were" if len(seen) > 1 else "was"
        raise InputError(
            f"{joined(seen)} {verb} fitted on frames that would be scored here, so that the scores "
            "flatter. Keep frames back when fitting, judge on another file, or say that "
            "this is meant (--allow-seen)."
        )
    return frames


def seen_frames(fits: Mapping[str, Fit], tracks: xr.Dataset) -> tuple[Segment, ...]:
    """Return the frames that all of the fits were trained on, to be left out in turn.

    Raises
    ------
    InputError
        If a fit was trained on others, or its posterior cannot forget: weights that are points.
    """
    foreign = [name for name, fit in fits.items() if not same_tracks(fit, tracks)]
    if foreign:
        verb = "were" if len(foreign) > 1 else "was"
        raise InputError(
            f"{joined(foreign)} {verb} not fitted on these tracks. Leave-one-out takes frames back "
            "out of a posterior that knows them; judge on unseen tracks by method held-out."
        )
    rigid = [name for name, fit in fits.items() if not _can_forget(fit)]
    if rigid:
        have = "have" if len(rigid) > 1 else "has"
        raise InputError(
            f"{joined(rigid)} {have} learned weights without a posterior, from which no frame can "
            "be taken back out by weighting draws. Compare by method held-out or lfo."
        )
    trained = {name: fit.split.train for name, fit in fits.items()}
    first = next(iter(trained))
    for name, segments in trained.items():
        if set(segments) != set(trained[first]):
            raise InputError(
                f"{name} was trained on other frames of these tracks than {first}, so that there "
                "is not the same to be left out. Fit both with one split, or compare by method "
                "held-out."
            )
    return trained[first]


def check_future(fits: Mapping[str, Fit], tracks: xr.Dataset, frames: ScoredFrames) -> None:
    """Refuse frames that lie before some that a fit was trained on.

    Raises
    ------
    InputError
        If there are such, naming fit and trial.
    """
    for name, fit in fits.items():
        if not same_tracks(fit, tracks):
            continue
        for own in fit.split.train:
            for scored in frames.segments:
                if scored.trial == own.trial and scored.start < own.stop:
                    raise InputError(
                        f"{name}: of trial {own.trial} it was trained on frames that come after "
                        "some of those to be scored. Leave-future-out needs runs whose held-out "
                        "frames come last (split_by time) or are trials of their own."
                    )


def _can_forget(fit: Fit) -> bool:
    """Return whether everything that a fit learned has a posterior."""
    model = fit.model
    if not isinstance(model, StateSpaceModel) or not priors_of(model):
        return False
    guide = getattr(fit.guide, "parameters_guide", None)
    if guide is None or getattr(guide, "kind", "") == "delta":
        return False
    return not any(weight.numel() for weight in model.parameters())
