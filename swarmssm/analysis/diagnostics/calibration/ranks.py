"""Ranks of true values among posterior draws, and what they say of the posterior."""

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy import stats

from swarmssm.analysis.diagnostics.calibration.uniformity import (
    ecdf_band,
    histogram_interval,
    uniformity_p_value,
)
from swarmssm.errors import InputError

__all__ = ["calibration_of_ranks", "calibration_sentence", "calibration_table"]

#: Levels of the central intervals whose coverage is counted.
LEVELS = (0.5, 0.8, 0.9, 0.95)
#: Bins of a rank histogram.
BINS = 20
#: A band holds a calibrated parameter this often, and an interval its coverage.
CONFIDENCE = 0.95


def calibration_of_ranks(
    ranks: Mapping[str, npt.ArrayLike], draws: int, *, level: float = CONFIDENCE
) -> xr.Dataset:
    """Say of ranks whether they are uniform.

    Parameters
    ----------
    ranks
        Name -> ``(dataset,)``, of the truth among draws of its posterior, from 0 to ``draws``.
    draws
        Number of draws.
    level
        Probability of the band, of the coverages' intervals, and of those of the histogram's bins.

    Returns
    -------
    Dataset with, for each ``parameter``:

    ``rank (parameter, dataset)``
        The ranks.
    ``ecdf (parameter, point)``, ``ecdf_low (point)``, ``ecdf_high (point)``
        Share of ranks below each point, and the band in which the whole of it lies with
        probability ``level`` (:func:`swarmssm.analysis.diagnostics.calibration.ecdf_band`).
    ``passes (parameter)``, ``p_value (parameter)``
        1 if all of it is inside the band; and the probability of ranks as uneven as these.
    ``histogram (parameter, bin)``, ``expected (bin)``, ``histogram_low``, ``histogram_high (bin)``
        Ranks in each bin, how many there would be, and the pointwise intervals.
    ``coverage (parameter, level)``, ``coverage_low``, ``coverage_high``, ``expected_coverage``
        Share of central intervals that hold the truth, with exact binomial (Clopper-Pearson)
        intervals, and what it would be.

    Raises
    ------
    InputError
        If there are no ranks, or their numbers differ.
    """
    names = list(ranks)
    lengths = {len(np.asarray(values)) for values in ranks.values()}
    if len(lengths) != 1 or lengths == {0}:
        raise InputError("ranks: there must be some, and as many for each parameter.")
    table: npt.NDArray[np.int64] = np.array(
        [np.asarray(ranks[name]) for name in names], dtype=np.int64
    )
    number = table.shape[1]
    p_values = [uniformity_p_value(row, draws) for row in table]
    points, low, high = ecdf_band(number, draws, level)
    ecdf = (table[:, None, :] < points[None, :, None] * (draws + 1) - 1e-6).mean(-1)
    inside = (ecdf >= low - 1e-9) & (ecdf <= high + 1e-9)

    bins = min(BINS, draws + 1)
    place = table * bins // (draws + 1)
    share = np.bincount(np.arange(draws + 1) * bins // (draws + 1), minlength=bins) / (draws + 1)
    histogram = np.stack([np.bincount(row, minlength=bins) for row in place])
    bounds = np.array([histogram_interval(number, float(part), level) for part in share])

    middle = np.abs(2.0 * (np.arange(draws + 1) + 0.5) / (draws + 1) - 1.0)
    within = middle[table][..., None] <= np.array(LEVELS) + 1e-9
    hits = within.sum(1)
    tail = 0.5 * (1.0 - level)
    lowest = np.where(hits > 0, stats.beta.ppf(tail, hits, number - hits + 1), 0.0)
    highest = np.where(hits < number, stats.beta.isf(tail, hits + 1, number - hits), 1.0)

    data = {
        "rank": (("parameter", "dataset"), table, "rank of the truth among posterior draws"),
        "ecdf": (("parameter", "point"), ecdf, "share of ranks below"),
        "ecdf_low": (("point",), low, "lower end of the band"),
        "ecdf_high": (("point",), high, "upper end of the band"),
        "passes": (("parameter",), inside.all(-1).astype(np.uint8), "inside the band"),
        "p_value": (("parameter",), np.array(p_values), "probability of as uneven ranks"),
        "histogram": (("parameter", "bin"), histogram, "ranks in the bin"),
        "expected": (("bin",), share * number, "expected ranks in the bin"),
        "histogram_low": (("bin",), bounds[:, 0], "lower end of the interval of a bin"),
        "histogram_high": (("bin",), bounds[:, 1], "upper end of the interval of a bin"),
        "coverage": (("parameter", "level"), hits / number, "share of intervals with the truth"),
        "coverage_low": (("parameter", "level"), lowest, "lower end of its interval"),
        "coverage_high": (("parameter", "level"), highest, "upper end of its interval"),
        "expected_coverage": (
            ("level",),
            (middle[:, None] <= np.array(LEVELS) + 1e-9).mean(0),
            "coverage if the posterior is right",
        ),
    }
    return xr.Dataset(
        {
            name: (dims, values, {"long_name": title, "units": "1"})
            for name, (dims, values, title) in data.items()
        },
        {
            "parameter": names,
            "point": points,
            "bin": (np.arange(bins) + 0.5) / bins,
            "level": list(LEVELS),
        },
        {"draws": draws, "datasets": number, "band_level": level},
    )


def calibration_sentence(calibration: xr.Dataset) -> str:
    """Return what a calibration says, in one or two plain sentences.

    Parameters
    ----------
    calibration
        From :func:`simulation_based_calibration` or :func:`calibration_of_ranks`.
    """
    number, level = int(calibration.attrs["datasets"]), float(calibration.attrs["band_level"])
    names = [str(name) for name in calibration["parameter"].values]
    passes = calibration["passes"].to_numpy().astype(bool)
    failed = int(calibration.attrs.get("failed", 0))
    lost = f" {failed} further data sets failed and are not counted." if failed else ""
    if passes.all():
        return (
            f"The ranks of all {len(names)} quantities lie within the {100 * level:.0f} % band "
            f"over {number} simulated data sets: the posterior is as sure as it may be, as far as "
            f"so many can tell (a share of 90 % is known to {100 * _error(number):.1f} %).{lost}"
        )
    off = [
        _verdict(calibration.sel(parameter=n)) for n, ok in zip(names, passes, strict=True) if ~ok
    ]
    chance = (1.0 - level) * len(names)
    return (
        f"Of {len(names)} quantities, {int(passes.sum())} have ranks within the "
        f"{100 * level:.0f} % band over {number} simulated data sets, and {len(off)} not: "
        f"{'; '.join(off)}. By chance alone one would expect {chance:.1f} outside.{lost}"
    )


def _verdict(one: xr.Dataset) -> str:
    """Say in what way the ranks of a parameter are uneven."""
    coverage = float(one["coverage"].sel(level=0.9))
    mean = float(one["rank"].mean()) / float(one.attrs["draws"])
    # Three standard errors of the mean of as many uniform numbers.
    error = 3.0 * math.sqrt(1.0 / 12.0 / one.sizes["dataset"])
    side = ""
    if abs(mean - 0.5) > error:
        side = ", estimates too " + ("low" if mean > 0.5 else "high")
    return f"{one['parameter'].item()} (90 % intervals hold {100 * coverage:.0f} %{side})"


def _error(number: int) -> float:
    """Return the standard error of a coverage of 0.9."""
    return math.sqrt(0.09 / number)


def calibration_table(calibration: xr.Dataset) -> list[dict[str, object]]:
    """Return a row for each quantity: verdict, p-value, coverage of its central intervals.

    Parameters
    ----------
    calibration
        From :func:`calibration_of_ranks`.
    """
    rows: list[dict[str, object]] = []
    for name in calibration["parameter"].values:
        one = calibration.sel(parameter=name)
        row: dict[str, object] = {
            "quantity": str(name),
            "in the band": "yes" if bool(one["passes"]) else "no",
            "p": float(one["p_value"]),
        }
        for level in calibration["level"].values:
            row[f"{100 * level:.0f} % intervals"] = float(one["coverage"].sel(level=level))
        rows.append(row)
    return rows
