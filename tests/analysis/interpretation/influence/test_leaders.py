"""Hold decisions to posteriors made by hand, and to their stated rates of false alarms."""

import math

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.interpretation.influence.leaders import find_isolated, find_leader
from swarmssm.errors import InputError

DATA_SETS = 250


def posterior(truth, rng, draws=4000, deviation=0.2):
    """Return draws of log-weights about an estimate that is as far off as they say."""
    estimate = truth + deviation * rng.standard_normal(len(truth))
    return np.exp(estimate + deviation * rng.standard_normal((draws, len(truth))))


def labelled(sent, received=None):
    """Return weights as find_leader takes them."""
    data = {"weight": (("sample", "individual"), sent)}
    if received is not None:
        data["responsiveness"] = (("sample", "individual"), received)
    return xr.Dataset(data, {"individual": [f"fish{place}" for place in range(sent.shape[1])]})


def by_trials(scores):
    """Return a dataset without weights whose outgoing influence in each trial is given."""
    trials, number = scores.shape
    pairs = np.broadcast_to(scores[:, None, :], (trials, number, number)).copy()
    pairs[:, np.arange(number), np.arange(number)] = np.nan
    return xr.Dataset(
        {"trial_influence": (("trial", "individual", "neighbor"), pairs)},
        {"individual": [str(place) for place in range(number)]},
    )


def test_alarms_by_hand():
    """Of 1000 draws the first is not above the second in 30 and not above the third in 10.

    Against each: 2 * 0.03. It is not above the mean of both in 20: 3 * 0.02.
    """
    weights = np.tile([3.0, 1.0, 1.0], (1000, 1))
    weights[:20] = [1.0, 3.0, 0.5]  # 3.5 / 2 for the mean of the others: not above either
    weights[20:30] = [2.0, 2.5, 0.5]  # above their mean
    weights[30:40] = [2.0, 0.5, 2.0]  # no more than the third
    each = find_leader(labelled(weights), 0.1)
    assert float(each["alarm"][0]) == pytest.approx(0.06)
    assert float(each["alarm"][1]) == 1.0
    assert each.attrs["leader"] == "fish0"
    assert each["leads"].values.tolist() == [True, False, False]
    rest = find_leader(labelled(weights), 0.1, against="rest")
    assert float(rest["alarm"][0]) == pytest.approx(0.06)
    nobody = find_leader(labelled(weights), 0.05)
    assert nobody.attrs["leader"] == ""
    assert not nobody["leads"].any()
    assert nobody.attrs["by"] == "weights"


@pytest.mark.parametrize(
    ("against", "truth", "expected"),
    [
        # Two far ahead of the others: either may seem surely first, each with 0.025.
        ("each", [1.5, 1.5, 0.0, 0.0], 0.05),
        # The gap of the two largest of six normals exceeds 1.96 sqrt(2) with 0.0025.
        ("each", [0.0] * 6, 0.0025),
        # Bonferroni's bound, nearly reached.
        ("rest", [0.0] * 6, 0.05),
    ],
)
def test_the_rate_of_false_alarms_is_kept(against, truth, expected):
    rng = np.random.default_rng(0)
    alarms = [
        find_leader(labelled(posterior(np.array(truth), rng, 2400)), 0.05, against=against)
        for _ in range(DATA_SETS)
    ]
    rate = np.mean([found.attrs["leader"] != "" for found in alarms])
    # Draws end the tail of 0.025 or 0.008 a little early or late, by some tenths of itself.
    assert abs(rate - expected) < 4 * math.sqrt(expected * (1 - expected) / DATA_SETS) + 0.005


def test_a_leader_is_found_whatever_the_place():
    rng = np.random.default_rng(1)
    for place in range(5):
        truth = np.zeros(5)
        truth[place] = 1.5
        assert find_leader(labelled(posterior(truth, rng))).attrs["leader"] == f"fish{place}"


def test_by_trials_the_same_one_must_come_out_on_top():
    """Always the third, of five in four trials: by chance that has 5 * 5 ** -4 = 0.008."""
    rng = np.random.default_rng(2)
    scores = rng.random((4, 5))
    scores[:, 2] = 2.0
    found = find_leader(by_trials(scores))
    assert found.attrs == {"rate": 0.05, "by": "trials", "leader": "2"}
    turned = np.stack([np.roll(row, shift) for shift, row in enumerate(scores)])
    assert find_leader(by_trials(turned)).attrs["leader"] == ""


def test_by_trials_the_rate_is_kept():
    """Names without meaning: p-values are uniform or larger, and under 0.05 in 0.05."""
    rng = np.random.default_rng(3)
    alarms = [
        float(find_leader(by_trials(rng.random((3, 5))), seed=seed)["alarm"].min())
        for seed in range(200)
    ]
    assert abs(np.mean(np.array(alarms) <= 0.5) - 0.5) < 4 * math.sqrt(0.25 / 200)


def test_one_trial_without_weights_says_nothing():
    found = find_leader(by_trials(np.array([[5.0, 1.0, 1.0]])))
    assert found.attrs["by"] == "nothing"
    assert found.attrs["leader"] == ""


def test_the_isolated_one_is_recognised():
    """The second sends and receives a tenth; the third sends as little, but is moved."""
    rng = np.random.default_rng(4)
    sent = posterior(np.log([1.0, 0.1, 0.1, 1.0, 1.0]), rng)
    received = posterior(np.log([1.0, 0.1, 1.0, 1.0, 1.0]), rng)
    found = find_isolated(labelled(sent, received))
    assert found["without_influence"].values.tolist() == [False, True, True, False, False]
    assert found["without_response"].values.tolist() == [False, True, False, False, False]
    assert found.attrs["isolated"] == "fish1"
    assert found.attrs["by"] == "weights"
    assert float(found["sent_share"][1]) == pytest.approx(0.1, rel=0.5)


def test_who_has_the_share_is_seldom_called_without_influence():
    """One that sends exactly half of what the others do is called so in 0.05 / N at most."""
    rng = np.random.default_rng(5)
    truth = np.log([0.5, 1.0, 1.0, 1.0, 1.0])
    called = [
        bool(find_isolated(labelled(*both))["without_influence"][0])
        for both in (
            (posterior(truth, rng, 2000), posterior(truth, rng, 2000)) for _ in range(DATA_SETS)
        )
    ]
    assert np.mean(called) < 0.01 + 4 * math.sqrt(0.01 / DATA_SETS)


@pytest.mark.parametrize(
    ("options", "word"),
    [({"rate": 0.0}, "rate"), ({"rate": 1e-4}, "draws"), ({"against": "all"}, "against")],
)
def test_mistakes(options, word):
    weights = labelled(np.random.default_rng(0).random((1000, 3)))
    with pytest.raises(InputError, match=word):
        find_leader(weights, **options)


def test_mistakes_of_isolated():
    weights = labelled(np.ones((1000, 3)), np.ones((1000, 3)))
    with pytest.raises(InputError, match="share"):
        find_isolated(weights, share=1.0)
    with pytest.raises(InputError, match="draws"):
        find_isolated(weights, 1e-4)
