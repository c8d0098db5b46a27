"""The two studies of simulated data, with sizes as asked for, else as in what they are to be like.

Options are those of the study's own function; what is ``None`` among sizes was not asked for.
"""

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from swarmssm.cli.calibrating.likeness import Likeness
from swarmssm.cli.progress import counting_progress

if TYPE_CHECKING:
    import xarray as xr

    from swarmssm.analysis.diagnostics.recovery.settings import Setting

__all__ = ["Study", "run_calibration", "run_recovery"]

#: Simulated data sets: of a calibration, and for each setting of a recovery.
CALIBRATED, RECOVERED = 200, 5
INDIVIDUALS, FRAMES, TRIALS, NOISE = 8, 80, 2, 0.03


class Study(StrEnum):
    """What is asked of the simulated data."""

    calibration = "calibration"
    recovery = "recovery"


def run_calibration(
    model: str,
    like: Likeness,
    *,
    datasets: int | None,
    sizes: Mapping[str, Any],
    graph: str | None,
    options: Mapping[str, Any],
) -> "xr.Dataset":
    """Ask whether intervals are as sure as they may be."""
    from swarmssm.analysis.diagnostics.calibration.simulation import simulation_based_calibration
    from swarmssm.analysis.diagnostics.calibration.synthetic import standard_scales

    individuals, noise = sizes["individuals"], sizes["noise"]
    if individuals is None:
        individuals = INDIVIDUALS if like.scales is None else like.scales.individuals
    scales = like.scales
    if scales is None:
        scales = standard_scales(max(individuals, 1), noise=NOISE if noise is None else noise)
    noise = scales.noise if noise is None else noise
    with counting_progress(f"calibration of {model}") as show:
        return simulation_based_calibration(
            model,
            datasets=CALIBRATED if datasets is None else datasets,
            individuals=individuals,
            frames=(like.frames or FRAMES) if sizes["frames"] is None else sizes["frames"],
            trials=(like.trials or TRIALS) if sizes["trials"] is None else sizes["trials"],
            scales=replace(scales, individuals=individuals, noise=noise),
            graph=graph or like.graph or "complete",
            progress=show,
            **options,
        )


def run_recovery(
    model: str,
    like: Likeness,
    *,
    datasets: int | None,
    sizes: Mapping[str, Any],
    graph: str | None,
    options: Mapping[str, Any],
) -> "xr.Dataset":
    """Ask how much data the parameters take."""
    from swarmssm.analysis.diagnostics.recovery.study import recovery_study

    if graph is None:
        graph = like.graph
    base = _base(like, graph)
    base = base.changed(**{name: size for name, size in sizes.items() if size is not None})
    with counting_progress(f"recovery with {model}") as show:
        return recovery_study(
            model,
            base=base,
            datasets=RECOVERED if datasets is None else datasets,
            scales=like.scales,
            graph=None if base.radius is not None else graph,
            progress=show,
            **options,
        )


def _base(like: Likeness, graph: str | None) -> "Setting":
    """Return the setting from which a recovery starts; without a radius if the graph is known."""
    from swarmssm.analysis.diagnostics.recovery.settings import Setting

    base: Setting = Setting()
    if like.scales is None:
        return base if graph is None else replace(base, radius=None)
    return replace(
        base,
        individuals=like.scales.individuals,
        radius=None,
        frames=like.frames or base.frames,
        trials=like.trials or base.trials,
        noise=like.noise or base.noise,
        density=like.density or base.density,
    )
