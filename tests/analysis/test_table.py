"""Tables for people."""

import math

import pytest

from swarmssm.analysis import edge_table, format_number, horizon_table, scores_table
from swarmssm.analysis.scoring.thesis import THESIS_TABLES, thesis_table_for
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.123456, "0.123"),
        (12.3456, "12.3"),
        (1234.56, "1235"),
        (0.99999, "1.00"),
        (9.999, "10.0"),
        (0.000123456, "0.000123"),
        (0.0000123456, "1.23e-5"),
        (1234567.0, "1.23e6"),
        (1e-12, "1.00e-12"),
        (-0.5, "-0.500"),
        (0.0, "0"),
        (math.inf, "infinite"),
        (math.nan, "–"),
        (None, "–"),
    ],
)
def test_numbers_have_three_significant_digits(value, text):
    assert format_number(value) == text


def test_scores_stand_beside_truth_and_thesis(planted):
    rows = scores_table(planted(mse=(0.5, 0.25, 0.125), floor=0.01))
    assert [row["method"] for row in rows[:5]] == [
        "graph-vae",
        "stay put",
        "constant velocity",
        "true rule (noise floor)",
        "truth",
    ]
    assert [row["MSE"] for row in rows[:5]] == ["0.500", "0.250", "0.125", "0.0100", "–"]
    assert rows[4]["AMD"] == "1.00"
    assert len({tuple(row) for row in rows}) == 1
    printed = {row["method"]: row for row in rows[5:]}
    assert len(printed) == 3
    guppies = printed["Graph VAE, thesis Table I (guppies)"]
    assert (guppies["MSE"], guppies["AMD"], guppies["AVD"]) == ("0.146", "0.960", "3.47")
    assert guppies["MAE"] == "–"


def test_the_thesis_table_can_be_chosen_or_left_out(planted):
    evaluation = planted()
    boids = scores_table(evaluation, thesis="boids")
    assert boids[-3]["method"] == "Graph VAE, thesis Table II (boids)"
    assert len(scores_table(evaluation, thesis=None)) == 4
    with pytest.raises(InputError, match="thesis: 'sheep' is unknown"):
        scores_table(evaluation, thesis="sheep")


def test_the_thesis_figures_are_those_printed():
    found = {name: [(r.mse, r.amd, r.avd) for r in rows] for name, rows in THESIS_TABLES.items()}
    assert found == {
        "guppies": [(0.146, 0.96, 3.47), (0.902, 0.957, 2.451), (0.3452, 0.902, 2.5734)],
        "boids": [(0.354, 0.7123, 1.542), (0.235, 0.5642, 0.956), (0.415, 0.763, 1.345)],
    }


def test_simulated_tracks_stand_beside_the_table_on_boids(boids):
    assert thesis_table_for(boids) == "boids"
    assert thesis_table_for(make_tracks([[[0.0, 0.0]], [[1.0, 1.0]]], fps=1.0)) == "guppies"


def test_horizons_and_edges_have_tables_of_their_own(planted):
    evaluation = planted(squared_error=(0.25, 0.5, 0.75), accuracy=(0.9, 0.8, 0.7, 0.6))
    assert horizon_table(evaluation)[0] == {
        "method": "graph-vae",
        "1 step": "0.250",
        "5 steps": "0.250",
        "20 steps": "0.250",
    }
    assert edge_table(evaluation)[1] == {
        "predictor": "same graph as before",
        "accuracy": "0.800",
        "precision": "0.800",
        "recall": "0.800",
        "AUC": "0.800",
    }
