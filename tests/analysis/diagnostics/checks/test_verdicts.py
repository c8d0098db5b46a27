"""Sentences of checks whose outcome is planted."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.diagnostics.checks.p_values import adjusted_p_values, judge
from swarmssm.analysis.diagnostics.checks.verdicts import sentence, verdicts

NEVER = np.zeros(99, dtype=bool)


def said(kind, own, replicated, unit="1"):
    judged = [judge(kind, own, replicated)]
    return verdicts(
        ["s"],
        ["group area"],
        [kind],
        [unit],
        {"s": np.asarray(own)},
        {"s": np.asarray(replicated)},
        judged,
        adjusted_p_values(judged),
        NEVER[: len(replicated)],
    )[0]


def test_a_number_is_told_with_its_place():
    replicated = np.linspace(1.0, 2.0, 99)
    verdict, words = said("number", 5.0, replicated, "px^2")
    assert verdict == "unlike"
    assert words.startswith("The group area is 5.00 px², above the 1.04 to 1.96 of 90 % of")
    assert "p = 0.020, 0.020 with all" in words
    verdict, words = said("number", 1.5, replicated)
    assert verdict == "alike"
    assert "within" in words
    assert "nothing speaks against the model here (p = 1.00)" in words


def test_a_curve_is_told_by_the_points_outside():
    curves = np.linspace(-1, 1, 99)[:, None] + np.zeros(4)
    verdict, words = said("curve", [0.0, 0.0, 5.0, 5.0], curves)
    assert verdict == "unlike"
    assert "outside of the central 90 % of the replicates at 2 of 4 points" in words


def test_what_the_recording_lacks_is_unknown():
    verdict, words = said("number", np.nan, np.arange(99.0))
    assert (verdict, words) == ("unknown", "The recording has no group area.")


def planted(*outcomes, part="test", notes=""):
    """Return what a sentence is made of."""
    return xr.Dataset(
        {"verdict": ("statistic", list(outcomes))},
        {
            "statistic": [f"s{i}" for i in range(len(outcomes))],
            "title": ("statistic", [f"title {i}" for i in range(len(outcomes))]),
        },
        {"draws": 100, "steps": 50, "part": part, "notes": notes},
    )


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        (("alike",) * 3, "Of 3 statistics in 100 swarms simulated from the posterior, none tells"),
        (("alike", "unlike"), "1 tells the recording from them"),
        (("unlike", "unlike"), "The model does not reproduce these"),
        (("doubtful",) + ("alike",) * 19, "chance alone gives about 1.0"),
        (("alike", "unknown"), "Of one statistic"),
        (("unknown",), "nothing was checked"),
    ],
)
def test_a_check_as_a_whole(outcomes, words):
    assert words in sentence(planted(*outcomes))


def test_it_says_how_far_it_can_be_believed():
    assert "may still tell them apart" in sentence(planted("alike"))
    assert "free runs of 50 frames in the test part" in sentence(planted("alike"))
    trained = planted("alike", part="all", notes="... frames that the model was trained on.")
    assert "less than it seems" in sentence(trained)


@pytest.mark.parametrize(
    ("draws", "words"),
    [(30, "of so few no p-value is lower (p = 0.065)"), (50, "does not make swarms like this")],
)
def test_too_few_draws_do_not_speak_for_the_model(draws, words):
    """Of 30 replicates none can be below 2 / 31; a recording outside of all is not alike them."""
    replicated = np.linspace(0.0, 1.0, draws)
    p_value = 2.0 / (draws + 1)
    judged = [SimpleNamespace(p_value=p_value, hellinger=0.0, hellinger_among=0.0)]
    own, drawn = {"a": np.array(2.0)}, {"a": replicated}
    none = np.zeros(draws, dtype=bool)
    [(_, said)] = verdicts(
        ["a"], ["speed"], ["number"], ["cm/s"], own, drawn, judged, np.array([p_value]), none
    )
    assert words in said
    assert "nothing speaks" not in said
