"""Scores over horizons, and how much better they are than those of a reference."""

import numpy as np
import xarray as xr

from swarmssm.analysis.scoring.scores import LOWER_IS_BETTER, SCORES
from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["at_level", "check_model", "score_table", "skill"]


def score_table(scores: xr.Dataset, score: str = "log_score", level: float = 0.9) -> xr.DataArray:
    """Return the mean of a score over origins, each weighted by the individuals counted in it.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    score
        One of :data:`swarmssm.analysis.scoring.SCORES`.
    level
        Of the interval, for the last two.

    Returns
    -------
    ``(model, horizon)``; NaN where nobody was counted.

    Raises
    ------
    InputError
        If there is no such score or level.
    """
    values = at_level(scores, score, level)
    number = scores["number"]
    known = values.notnull()
    with np.errstate(invalid="ignore"):
        total = (values * number).where(known & (number > 0), 0.0).sum("origin")
    count = number.where(known, 0).sum("origin")
    table = (total / count.where(count > 0)).transpose("model", "horizon")
    table.attrs = dict(scores[score].attrs)
    return table.rename(score)


def skill(
    scores: xr.Dataset, reference: str = "constant-velocity", perfect: str | None = None
) -> xr.Dataset:
    r"""Return how much better the models are than a reference.

    .. math:: \frac{\bar S_{ref} - \bar S}{\bar S_{ref} - \bar S_{perfect}}

    with the scores averaged first. Of CRPS, energy score and squared error perfect is 0: a skill of
    0.3 is an error less by 30 %, a negative one says that the reference is better. The log score
    has no such end: without ``perfect`` it is the plain difference, in nats per coordinate.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    reference
        Name of the reference.
    perfect
        Name of a model that counts as perfect: of simulated tracks ``"noise-floor"``, the true
        rule. A skill of 1 then says that a model is as good as the truth, and nobody can be better
        than by chance.

    Returns
    -------
    Each score with a direction, ``(model, horizon)``; NaN where the reference
    is as good as perfect.

    Raises
    ------
    InputError
        If there is no such model.
    """
    check_model(scores, reference, "reference")
    if perfect is not None:
        check_model(scores, perfect, "perfect")
    data = {}
    for score in (name for name, one in SCORES.items() if one.sign):
        table = score_table(scores, score)
        base = table.sel(model=reference, drop=True)
        gain = base - table
        if perfect is not None:
            span = base - table.sel(model=perfect, drop=True)
            value, units = gain / span.where(span != 0), "1"
        elif score not in LOWER_IS_BETTER:
            value, units = -gain, str(table.attrs["units"])
        else:
            value, units = gain / base.where(base != 0), "1"
        value.attrs = {"units": units, "long_name": f"skill against {reference}: {score}"}
        data[score] = value.transpose("model", "horizon")
    attrs = {"reference": reference} | ({} if perfect is None else {"perfect": perfect})
    return xr.Dataset(data, attrs=attrs)


def at_level(scores: xr.Dataset, score: str, level: float) -> xr.DataArray:
    """Return a score ``(model, origin, horizon)``, of an interval that of one level.

    Raises
    ------
    InputError
        If there is no such score or level.
    """
    if score not in SCORES:
        raise InputError(f"score: {score!r} is unknown; choose one of {', '.join(SCORES)}.")
    values = scores[score]
    if "level" not in values.dims:
        return values
    levels: Array = scores["level"].to_numpy()
    near = np.flatnonzero(np.isclose(levels, level))
    if not near.size:
        known = ", ".join(f"{one:g}" for one in levels)
        raise InputError(f"level: {level:g} was not scored; choose one of {known}.")
    return values.isel(level=int(near[0]))


def check_model(scores: xr.Dataset, name: str, argument: str) -> None:
    """Refuse a model that was not scored.

    Raises
    ------
    InputError
        With the models that there are.
    """
    known = [str(model) for model in scores["model"].values]
    if name not in known:
        raise InputError(
            f"{argument}: there is no model {name!r}; choose one of {', '.join(known)}."
        )
