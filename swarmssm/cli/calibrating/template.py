"""Template of simulated data: a file of tracks, a fitted run, or both."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarmssm.models import Scales

__all__ = ["SimulationTemplate", "template_of"]

#: Settings of a run with which simulated data are fitted too.
KEPT = ("model", "guide", "model_options", "guide_options", "priors", "steps", "epochs")
#: Posterior draws of which the median is taken.
DRAWS = 2000


@dataclass(frozen=True)
class SimulationTemplate:
    """Sizes, scales and parameters that simulated data take from data; ``None`` if unknown.

    Attributes
    ----------
    scales
        From which the default priors follow.
    frames, trials, noise, density, graph
        Size of a data set, and the neighbourhood rule.
    values
        Posterior medians of a run.
    settings
        Settings of its fit.
    """

    scales: "Scales | None" = None
    frames: int | None = None
    trials: int | None = None
    noise: float | None = None
    density: float | None = None
    graph: str | None = None
    values: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)


def template_of(file: Path | None, run: Path | None, trust_code: bool) -> SimulationTemplate:
    """Return the template of a file, a run or both; where both tell, the run counts."""
    known = SimulationTemplate() if run is None else _of_run(run, trust_code)
    if file is not None:
        known = _with_file(known, file)
    if known.scales is None:
        return known
    low, high = known.scales.low, known.scales.high
    area = math.prod(up - down for down, up in zip(low, high, strict=True))
    return replace(known, density=known.scales.individuals / area if area > 0 else None)


def _of_run(run: Path, trust_code: bool) -> SimulationTemplate:
    """Return scales, settings and posterior medians of a run."""
    from swarmssm import inference

    fitted = inference.Fit.load(run, trust_code=trust_code)
    drawn = fitted.parameters(DRAWS)
    values = {str(n): drawn[n].median("draw").to_numpy().tolist() for n in drawn.data_vars}
    given = fitted.settings.model_dump(mode="json")
    rule = fitted.preparation.rule
    noise = values.get("emission.noise", fitted.scales.noise)
    return SimulationTemplate(
        scales=fitted.scales,
        noise=noise if isinstance(noise, float) and noise > 0 else None,
        graph=None if rule is None else str(rule),
        values=values,
        settings={name: given[name] for name in KEPT if given[name] not in (None, {})},
    )


def _with_file(known: SimulationTemplate, file: Path) -> SimulationTemplate:
    """Add the sizes of a file of tracks, and what the run does not tell."""
    from swarmssm import io
    from swarmssm.graphs import default_rule, rule_of
    from swarmssm.models import scales_of
    from swarmssm.tracks import with_trials

    tracks = with_trials(io.read(file))
    scales = scales_of(tracks)
    return replace(
        known,
        scales=known.scales or scales,
        frames=tracks.sizes["time"],
        trials=tracks.sizes["trial"],
        noise=known.noise or scales.noise or None,
        graph=known.graph or str(rule_of(tracks) or default_rule(tracks)),
    )
