"""Result of a posterior predictive check: its table, its values and its verdict."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from swarmssm.analysis.posterior.intervals import quantiles

__all__ = ["LEVEL", "PredictiveCheck", "verdict_of"]

#: Level of the tests.
LEVEL = 0.05
#: Share of diverged replicates from which a model is a mismatch to any recording.
MANY_DIVERGED = 0.05
#: Relative rounding error of a p-value.
ROUNDING = 1e-9


def verdict_of(p_value: float, adjusted: float, least: float) -> str:
    """Return the verdict on a statistic.

    Parameters
    ----------
    p_value, adjusted
        Without and with allowance for the number of statistics; NaN without a value.
    least
        Smallest p-value that the number of replicates allows.

    Returns
    -------
    ``"unknown"``; ``"mismatch"``: both below 0.05; ``"borderline"``: only the first, or the
    smallest possible where so few replicates allow none below 0.05; else ``"consistent"``.
    """
    if np.isnan(p_value):
        return "unknown"
    if p_value < LEVEL:
        return "mismatch" if adjusted < LEVEL else "borderline"
    too_few = least >= LEVEL and p_value <= least * (1.0 + ROUNDING)
    return "borderline" if too_few else "consistent"


def verdict_of_divergence(diverged: npt.NDArray[np.bool_]) -> str:
    """Return the verdict on the share of replicates that diverged, of which there are some."""
    return "mismatch" if diverged.mean() >= MANY_DIVERGED else "borderline"


@dataclass(frozen=True)
class PredictiveCheck:
    """Result of :func:`~swarmssm.analysis.check`.

    Attributes
    ----------
    data
        Observed and replicated values of all statistics, and their p-values; see ``check``.
    """

    data: xr.Dataset

    def summary(self) -> pd.DataFrame:
        """Return a row for each statistic, the largest deviation first.

        ``observed`` is the recorded value of a number, ``low`` and ``high`` the central 90 % of the
        replicates; NaN for curves and histograms. ``p_adjusted`` allows for the number of
        statistics.
        """
        rows = []
        for name in map(str, self.data["statistic"].values):
            one = self.data.sel(statistic=name)
            own = self.data[f"{name}_observed"]
            low, high = np.nan, np.nan
            if not own.ndim:
                low, _, high = quantiles(self.data[f"{name}_replicated"].to_numpy())
            rows.append(
                {
                    "statistic": name,
                    "verdict": str(one["verdict"].item()),
                    "observed": np.nan if own.ndim else float(own),
                    "low": float(low),
                    "high": float(high),
                    "unit": "" if own.ndim else str(own.attrs["units"]),
                    "p_value": float(one["p_value"]),
                    "p_adjusted": float(one["p_adjusted"]),
                    "distance": float(one["place"]),
                }
            )
        frame = pd.DataFrame(rows).set_index("statistic")
        return frame.sort_values("distance", key=np.abs, ascending=False, kind="stable")

    def to_pandas(self) -> pd.DataFrame:
        """Return every value of every statistic.

        Columns ``statistic``, ``place`` (coordinates along its axes, empty for a number),
        ``observed``, and ``low``, ``median``, ``high`` of the replicates.
        """
        frames = []
        for name in map(str, self.data["statistic"].values):
            own, drawn = self.data[f"{name}_observed"], self.data[f"{name}_replicated"]
            low, middle, high = (np.ravel(part) for part in quantiles(drawn.to_numpy()))
            places = [
                ", ".join(
                    f"{own[dim].values[at]:.6g}" for dim, at in zip(own.dims, index, strict=True)
                )
                for index in np.ndindex(own.shape)
            ]
            frames.append(
                pd.DataFrame(
                    {
                        "statistic": name,
                        "place": places,
                        "observed": np.ravel(own.to_numpy()),
                        "low": low,
                        "median": middle,
                        "high": high,
                    }
                )
            )
        return pd.concat(frames, ignore_index=True)

    def verdict(self) -> str:
        """Return in one line whether simulated swarms match the recording."""
        verdicts = self.data["verdict"].to_numpy().astype(str)
        titles = self.data["title"].to_numpy().astype(str)
        count = int((verdicts != "unknown").sum())
        if not count:
            return "Unknown: this recording has none of the statistics."
        attrs = self.data.attrs
        part = "all frames" if attrs["part"] == "all" else f"the {attrs['part']} part"
        what = f"{attrs['draws']} swarms simulated for {attrs['steps']} frames from {part}"
        mismatch = list(titles[verdicts == "mismatch"])
        borderline = int((verdicts == "borderline").sum())
        more = f", {borderline} borderline" if borderline else ""
        if mismatch:
            text = (
                f"Mismatch in {len(mismatch)} of {count} statistics ({', '.join(mismatch)})"
                f"{more}; {what}"
            )
        else:
            text = f"No mismatch in {count} statistics{more}; {what}"
        if "trained on" in attrs["notes"] or "chosen by" in attrs["notes"]:
            text += "; these frames were used in training, which favours the model"
        return f"{text}."
