"""What simulated data are to be like: a file of tracks, a fitted run, or both."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarmssm.models import Scales

__all__ = ["Likeness", "likeness_of"]

#: Settings of a run that its simulated data are fitted with too.
KEPT = ("model", "guide", "model_options", "guide_options", "priors", "steps", "epochs")
#: Draws of which the median is taken as what a run found.
DRAWS = 2000


@dataclass(frozen=True)
class Likeness:
    """What simulated data are to be like, as far as it is known.

    Attributes
    ----------
    scales
        From which priors are taken.
    frames, trials, noise, density, graph
        Sizes of a data set, and who sees whom, by its name.
    values
        Parameters that a run found.
    settings
        What it was fitted with.
    """

    scales: "Scales | None" = None
    frames: int | None = None
    trials: int | None = None
    noise: float | None = None
    density: float | None = None
    graph: str | None = None
    values: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)


def likeness_of(file: Path | None, run: Path | None, trust_code: bool) -> Likeness:
    """Read what simulated data are to be like; of file and run the run comes first."""
    like = Likeness() if run is None else _of_run(run, trust_code)
    if file is not None:
        like = _with_file(like, file)
    if like.scales is None:
        return like
    low, high = like.scales.low, like.scales.high
    area = math.prod(up - down for down, up in zip(low, high, strict=True))
    return replace(like, density=like.scales.individuals / area if area > 0 else None)


def _of_run(run: Path, trust_code: bool) -> Likeness:
    """Read scales, settings and found parameters of a run."""
    from swarmssm import inference

    fitted = inference.Fit.load(run, trust_code=trust_code)
    drawn = fitted.parameters(DRAWS)
    values = {str(n): drawn[n].median("draw").to_numpy().tolist() for n in drawn.data_vars}
    given = fitted.settings.model_dump(mode="json")
    rule = fitted.preparation.rule
    noise = values.get("emission.noise", fitted.scales.noise)
    return Likeness(
        scales=fitted.scales,
        noise=noise if isinstance(noise, float) and noise > 0 else None,
        graph=None if rule is None else str(rule),
        values=values,
        settings={name: given[name] for name in KEPT if given[name] not in (None, {})},
    )


def _with_file(like: Likeness, file: Path) -> Likeness:
    """Add sizes of a file of tracks, and what the run did not tell."""
    from swarmssm import io
    from swarmssm.graphs import default_rule, rule_of
    from swarmssm.models import scales_of
    from swarmssm.tracks import with_trials

    tracks = with_trials(io.read(file))
    scales = scales_of(tracks)
    return replace(
        like,
        scales=like.scales or scales,
        frames=tracks.sizes["time"],
        trials=tracks.sizes["trial"],
        noise=like.noise or scales.noise or None,
        graph=like.graph or str(rule_of(tracks) or default_rule(tracks)),
    )
