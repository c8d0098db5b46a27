"""Held-out log scores in words: only what the starts can tell."""

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.report.analysis_page import analysis_page
from swarmssm.analysis.report.held_out import own_model, score_rows, score_sentence, shown_models


def test_differences_are_told_where_the_starts_tell_them(scores):
    found = scores(boids=(-0.1, 0.0, -0.1), constant_velocity=(0.1, 0.1, 0.1))
    text = score_sentence(found, "graph-vae")
    assert "than boids it is better at 1 and 5 steps" in text
    assert "than constant velocity it is worse at every horizon" in text
    assert "60 starts of 2 trials" in text


def test_of_few_starts_nothing_is_told(scores):
    found = scores(boids=(-1.0, -1.0, -1.0)).isel(origin=slice(0, 4))
    text = score_sentence(found, "graph-vae")
    assert "than boids it is neither better nor worse. Means over 4 starts of 1 trial," in text


def test_both_ways_and_neither_way(scores):
    found = scores(boids=(-1.0, 1.0, 0.0), constant_velocity=(0.0, 0.0, 0.0))
    text = score_sentence(found, "graph-vae")
    assert "than boids it is better at 1 step and worse at 2 steps" in text
    assert "than constant velocity it is neither better nor worse" in text


def test_the_truth_is_no_rival(scores):
    found = scores(noise_floor=(1.0, 1.0, 1.0))
    assert "rivals" not in score_sentence(found, "graph-vae")
    assert [row["model"] for row in score_rows(found)] == ["graph-vae", "true rule (noise floor)"]


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_what_is_not_finite(scores, value):
    found = scores(boids=(0.0, 0.0, 0.0))
    found["log_score"].loc[{"model": "boids", "horizon": 5}] = value
    text = score_sentence(found, "graph-vae")
    shown = score_rows(found)[1]["5"]
    if np.isnan(value):
        assert "neither better nor worse" in text
        assert shown == "–"
    else:
        assert "better at 5 steps" in text
        assert shown == "-infinite"


def test_titles_stand_for_names(scores):
    found = scores(boids=(0.0, 0.0, 0.0)).assign_coords(title=("model", ["mine", "theirs"]))
    assert shown_models(found) == {"graph-vae": "mine", "boids": "theirs"}
    assert score_rows(found)[1]["model"] == "theirs"


def test_the_model_is_that_of_the_analysis_or_the_first(scores):
    found = scores(boids=(0.0, 0.0, 0.0))
    assert own_model(found, "boids") == "boids"
    assert own_model(found, "other") == "graph-vae"


def test_scores_go_with_the_file_and_onto_the_page_of_one_analysis(
    scores, quick_fit, boids, tmp_path
):
    found = analyze(quick_fit, boids, draws=1, only=["kernels"], scores=False)
    assert found.scores is None
    planted = scores(boids=(-1.0, -1.0, -1.0))
    whole = Analysis(kernels=found.kernels, scores=planted)
    whole.write(tmp_path / "a.nc")
    back = Analysis.read(tmp_path / "a.nc")
    assert back.scores is not None
    xr.testing.assert_identical(back.scores, planted)
    page = analysis_page(back, quick_fit, boids)
    assert "Held-out scores</h2>" in page
    assert '<th scope="row">boids</th><td>-31.50</td>' in page
    assert "than boids it is better at every horizon" in page
