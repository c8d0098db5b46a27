"""Verdicts of checks whose outcome is planted."""

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.diagnostics.checks.result import PredictiveCheck, verdict_of


@pytest.mark.parametrize(
    ("p_value", "adjusted", "draws", "verdict"),
    [
        (0.02, 0.02, 99, "mismatch"),
        (0.02, 0.4, 99, "borderline"),
        (0.5, 1.0, 99, "consistent"),
        (np.nan, np.nan, 99, "unknown"),
        # Of 30 replicates no two-sided p-value is below 2 / 31: the smallest says nothing.
        (2 / 31, 0.5, 30, "borderline"),
        (4 / 31, 0.5, 30, "consistent"),
    ],
)
def test_the_verdict_on_a_statistic(p_value, adjusted, draws, verdict):
    assert verdict_of(p_value, adjusted, 2 / (draws + 1)) == verdict


def planted(*outcomes, part="test", notes=""):
    """Return a check with planted verdicts."""
    return PredictiveCheck(
        xr.Dataset(
            {"verdict": ("statistic", list(outcomes))},
            {
                "statistic": [f"s{i}" for i in range(len(outcomes))],
                "title": ("statistic", [f"title {i}" for i in range(len(outcomes))]),
            },
            {"draws": 100, "steps": 50, "part": part, "notes": notes},
        )
    )


@pytest.mark.parametrize(
    ("outcomes", "start"),
    [
        (("consistent",) * 3, "No mismatch in 3 statistics; 100 swarms simulated for 50 frames"),
        (("consistent", "mismatch"), "Mismatch in 1 of 2 statistics (title 1);"),
        (("borderline",) + ("consistent",) * 19, "No mismatch in 20 statistics, 1 borderline"),
        (("consistent", "unknown"), "No mismatch in 1 statistics"),
        (("unknown",), "Unknown"),
    ],
)
def test_the_verdict_on_a_check(outcomes, start):
    assert planted(*outcomes).verdict().startswith(start)


def test_frames_of_the_training_are_named():
    trained = planted("consistent", part="all", notes="... frames that the model was trained on.")
    assert "favours the model" in trained.verdict()
    assert "favours" not in planted("consistent").verdict()
