"""Ranks of true values among posterior draws, and whether they are uniform."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr
from scipy import stats

from swarmssm.analysis.diagnostics.sbc.uniformity import (
    ecdf_band,
    histogram_interval,
    uniformity_p_value,
)
from swarmssm.errors import InputError

__all__ = ["Calibration", "calibration_of_ranks"]

#: Levels of the central intervals whose coverage is counted.
LEVELS = (0.5, 0.8, 0.9, 0.95)
#: Bins of a rank histogram.
BINS = 20
#: Probability that a band holds the ranks of a calibrated parameter, and an interval its coverage.
CONFIDENCE = 0.95


def calibration_of_ranks(
    ranks: Mapping[str, npt.ArrayLike], draws: int, *, level: float = CONFIDENCE
) -> xr.Dataset:
    """Test ranks for uniformity.

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
        probability ``level`` (:func:`swarmssm.analysis.diagnostics.sbc.ecdf_band`).
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


@dataclass(frozen=True)
class Calibration:
    """Result of :func:`~swarmssm.analysis.sbc`.

    Attributes
    ----------
    data
        Ranks, bands, coverage, truths and posteriors, see :func:`calibration_of_ranks`.
    """

    data: xr.Dataset

    def summary(self) -> pd.DataFrame:
        """Return a row for each quantity: ``in_band``, ``p_value``, coverage of its intervals."""
        frame = self.data[["passes", "p_value"]].to_dataframe()
        frame = frame.rename(columns={"passes": "in_band"}).astype({"in_band": bool})
        for level in self.data["level"].values:
            coverage = self.data["coverage"].sel(level=level).to_numpy()
            frame[f"coverage_{100 * level:.0f}"] = coverage
        return frame

    def to_pandas(self) -> pd.DataFrame:
        """Return a row for each quantity and data set: rank, truth and posterior."""
        names = [
            str(n) for n, values in self.data.items() if values.dims == ("parameter", "dataset")
        ]
        return self.data[names].to_dataframe().reset_index()

    def verdict(self) -> str:
        """Return in one line whether the posterior is calibrated, as far as the data sets tell."""
        attrs = self.data.attrs
        number, level = int(attrs["datasets"]), float(attrs["band_level"])
        names = [str(name) for name in self.data["parameter"].values]
        failed = int(attrs.get("failed", 0))
        lost = f" {failed} further data sets failed and are not counted." if failed else ""
        off = [name for name in names if not bool(self.data["passes"].sel(parameter=name))]
        if not off:
            # Standard error of a coverage of 0.9.
            error = 100.0 * math.sqrt(0.09 / number)
            return (
                f"Calibrated: the ranks of all {len(names)} quantities are within the "
                f"{100 * level:.0f} % band over {number} data sets (standard error of a 90 % "
                f"coverage: {error:.1f} %).{lost}"
            )
        return (
            f"Not calibrated: the ranks of {len(off)} of {len(names)} quantities leave the "
            f"{100 * level:.0f} % band over {number} data sets "
            f"({'; '.join(self._deviation(name) for name in off)}); by chance "
            f"{(1.0 - level) * len(names):.1f} would.{lost}"
        )

    def _deviation(self, name: str) -> str:
        """Return in what way the ranks of a quantity are not uniform."""
        one = self.data.sel(parameter=name)
        mean = float(one["rank"].mean()) / float(self.data.attrs["draws"])
        side = ""
        # Three standard errors of the mean of as many uniform numbers.
        if abs(mean - 0.5) > 3.0 * math.sqrt(1.0 / 12.0 / one.sizes["dataset"]):
            side = ", estimates too " + ("low" if mean > 0.5 else "high")
        return (
            f"{name}: coverage {100 * float(one['coverage'].sel(level=0.9)):.0f} % for 90 %{side}"
        )
