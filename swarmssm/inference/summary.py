"""What a fit shows of itself: a table of its posterior, and whether to trust it."""

import html
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyro.distributions as dist
import torch
import xarray as xr
from torch.distributions import biject_to

from swarmssm.inference.parameter_labels import at_place, short_names
from swarmssm.models.priors import parameters_of
from swarmssm.models.pyro_modules import priors_in
from swarmssm.models.units import units_of

if TYPE_CHECKING:
    from swarmssm.inference.fitted import Fit

__all__ = ["describe", "page", "posterior_table"]

COLUMNS = ["mean", "sd", "low", "high", "unit", "note"]
#: Draws of a prior to compare a posterior with.
PRIOR_DRAWS = 2000
#: Prior standard deviations beyond which a posterior is far from its prior.
FAR = 4.0
#: A posterior is its prior if its mean is within so many prior standard deviations, and its spread
#: within so large a share.
SAME_MEAN, SAME_SPREAD = 0.25, 0.2


def posterior_table(
    model: torch.nn.Module, drawn: xr.Dataset, unit: str, entries: int
) -> pd.DataFrame:
    """Summarise draws of parameters; :meth:`swarmssm.inference.Fit.summary` says how.

    Parameters
    ----------
    model
        The model, for its priors and units.
    drawn
        As :meth:`swarmssm.inference.Fit.parameters` returns it.
    unit
        Of length.
    entries
        Numbers of which a parameter may consist to have a row for each.
    """
    units = units_of(model, unit)
    known = parameters_of(model)
    rows: dict[str, tuple[object, ...]] = {}
    for name, label in short_names([str(name) for name in drawn.data_vars]).items():
        values = drawn[name].to_numpy()
        if values[0].size > entries:
            shape = " x ".join(map(str, values.shape[1:]))
            told = f"{shape} numbers; see interaction_kernels for curves, parameters() for draws"
            rows[label] = (np.nan, np.nan, np.nan, np.nan, units.get(name, ""), told)
            continue
        module, attribute = known[name]
        notes = _notes(priors_in(module).get(attribute), values)
        for place in np.ndindex(values.shape[1:]):
            column = values[(slice(None), *place)]
            low, high = np.quantile(column, [0.05, 0.95])
            note = str(notes[place])
            if column.std() <= 1e-9 * abs(column.mean()):
                low, high, note = np.nan, np.nan, "fixed"
            row = (column.mean(), column.std(), low, high, units.get(name, ""), note)
            rows[at_place(label, place)] = row
    table = pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)
    return table.rename_axis("parameter")


def _notes(prior: object, values: npt.NDArray[Any]) -> npt.NDArray[np.object_]:
    """Say of each number whether its posterior is its prior, or far away from it."""
    notes = np.full(values.shape[1:], "", dtype=object)
    # One that depends on other parameters is another with each draw.
    if not isinstance(prior, dist.Distribution):
        return notes
    free = biject_to(prior.support).inv
    with torch.random.fork_rng():
        torch.manual_seed(0)
        before = free(prior.sample((PRIOR_DRAWS,))).detach()
    after = free(torch.as_tensor(values))
    if before.shape[1:] != after.shape[1:]:  # such as correlations, which have fewer free numbers
        return notes
    if after.shape[1:] != notes.shape:
        return notes
    distance = ((after.mean(0) - before.mean(0)) / before.std(0)).abs().numpy()
    ratio = (after.std(0) / before.std(0)).numpy()
    same = (distance < SAME_MEAN) & (np.abs(ratio - 1.0) < SAME_SPREAD)
    notes[same] = "as its prior: the data say nothing of it"
    for place in np.argwhere(distance > FAR):
        notes[tuple(place)] = f"{distance[tuple(place)]:.0f} prior sd from its prior"
    return notes


def describe(fit: "Fit") -> dict[str, str]:
    """Return what a fit is, in a few words each."""
    settings, data = fit.settings, fit.provenance.get("data", {})
    facts = {"model": settings.model, "guide": settings.guide}
    counts = [
        f"{data[name]} {name}" for name in ("trials", "individuals", "frames") if data.get(name)
    ]
    if counts:
        facts["data"] = ", ".join(counts) + f", {data['fps']:g} frames per second"
    facts["parameters"] = f"{fit.num_parameters} learned"
    best = fit.history["validation_loss"].min() if "validation_loss" in fit.history else np.nan
    loss = f"{fit.history['loss'].iloc[-1]:.4g} nats per coordinate"
    facts["loss"] = loss if np.isnan(best) else f"{loss}; {best:.4g} in the validation part"
    facts["fit"] = fit.convergence.verdict
    return facts


def page(facts: Mapping[str, str], table: pd.DataFrame) -> str:
    """Return facts and a posterior as HTML."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
        f"<td style='text-align:left'>{html.escape(text)}</td></tr>"
        for name, text in facts.items()
    )
    shown = f"<table><tbody>{rows}</tbody></table>"
    if not len(table):
        return shown
    named = table.rename(columns={"low": "5 %", "high": "95 %"})
    posterior = named.to_html(float_format=lambda x: f"{x:.3g}", na_rep="", border=0)
    return f"{shown}<p>Posterior, with central 90 % intervals</p>{posterior}"
