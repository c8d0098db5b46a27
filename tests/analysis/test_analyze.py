"""All analyses of a fit in one go: what is there, what is left out, and the file."""

import html
import math
import re
import sys

import numpy as np
import pytest
import xarray as xr

from swarmssm import inference, io, simulate
from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.interpretation.forces.posterior import posterior_forces
from swarmssm.analysis.interpretation.result import ANALYSES, Analysis
from swarmssm.analysis.interpretation.summary import formatted_summary
from swarmssm.analysis.interpretation.verdict import forecast_test
from swarmssm.analysis.report import analysis_page
from swarmssm.analysis.report.contents import HEADINGS
from swarmssm.analysis.scoring.rolling_origin import score
from swarmssm.errors import InputError

QUICK = {"latents": {"shifts": 19, "untrained_seeds": 1}}


@pytest.fixture(scope="module")
def analysis(quick_fit, boids):
    return analyze(quick_fit, boids, draws=3, part="all", scores=False, options=QUICK)


@pytest.fixture(scope="module")
def written(analysis, tmp_path_factory):
    """The file of the analysis."""
    path = tmp_path_factory.mktemp("written") / "a.nc"
    analysis.write(path)
    return path


def test_all_is_there_for_a_plain_fit_in_two_dimensions(analysis):
    assert tuple(analysis.datasets) == ANALYSES
    assert analysis.forces["force"].sizes["draw"] == 3
    assert analysis.kernels["net_draws"].sizes["draw"] == 30
    assert analysis.force_maps["turning"].sizes["source"] == 2
    assert analysis.latents.attrs["shifts"] == 19
    assert analysis.settings["part"] == "all"
    seen, beyond = analysis.notes
    assert seen == "The frames include those that the model was trained on."
    # Other trials than the model was trained on go elsewhere in the arena.
    assert "outside the rectangle" in beyond


def test_forces_are_those_of_their_own_function(analysis, quick_fit, boids):
    alone = posterior_forces(quick_fit, boids, draws=3, seed=0)
    np.testing.assert_array_equal(analysis.forces["force"], alone["force"])
    mean = np.linalg.norm(alone["force"], axis=-2).mean((0, 1, 2, 3))
    shares = analysis.forces["mean_magnitude"].sel(quantile=0.5)
    # A one-step model knows the states: its draws are the same, and the median is the mean.
    np.testing.assert_allclose(shares, mean, rtol=1e-4)


def test_simulated_tracks_bring_their_truth(analysis):
    assert set(analysis.forces["truth_r_squared"].dims) == {"term"}
    kernels = analysis.kernels
    middle = kernels["net"].sel(quantile=0.5)
    assert kernels["truth_net"].shape == middle.shape
    true = kernels["truth_alignment"].to_numpy()
    # Alignment of boids does not depend on distance inside the radius.
    assert len(set(np.round(true[true > 0], 12))) == 1


def test_a_file_gives_back_every_number(analysis, written):
    back = Analysis.read(written)
    for name, dataset in analysis.datasets.items():
        xr.testing.assert_identical(back.datasets[name], dataset)
    assert back.verdict() == analysis.verdict()
    assert back.settings == analysis.settings
    assert back.notes == analysis.notes
    assert back.summary().equals(analysis.summary())


def test_anybody_can_open_the_file(analysis, written):
    with xr.open_datatree(written) as tree:
        assert set(tree.children) == set(ANALYSES)
    with xr.open_dataset(written, group="kernels") as kernels:
        np.testing.assert_array_equal(kernels["net"], analysis.kernels["net"])
        assert kernels["net"].attrs["units"]


def test_an_existing_file_is_kept(quick_fit, boids, tmp_path):
    forces = analyze(quick_fit, boids, draws=1, only=["forces"], part="all", scores=False)
    path = tmp_path / "a.nc"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        forces.write(path)
    assert path.read_text() == "precious"
    forces.write(path, overwrite=True)
    assert Analysis.read(path).settings == forces.settings


def test_other_files_are_refused(boids, tmp_path):
    io.write(boids, tmp_path / "tracks.nc")
    (tmp_path / "bad.nc").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"tracks\.nc: it is no file of swarmssm analyze"):
        Analysis.read(tmp_path / "tracks.nc")
    with pytest.raises(InputError, match=r"bad\.nc"):
        Analysis.read(tmp_path / "bad.nc")
    with pytest.raises(InputError, match=r"absent\.nc"):
        Analysis.read(tmp_path / "absent.nc")


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ({"draws": 0}, "draws"),
        ({"seed": -1}, "seed"),
        ({"part": "last"}, "part: 'last'"),
        ({"only": ["force"]}, "only: 'force'"),
        ({"only": []}, "only"),
        ({"options": {"maps": {}}}, "options: 'maps'"),
        ({"options": {"force_maps": {"bin": 3}}}, "force_maps has no option 'bin'; it has bins"),
        ({"options": {"force_maps": {"seed": 3}}}, "no option 'seed'"),
        ({"only": ["force_maps"], "options": {"force_maps": {"bins": 1}}}, "bins"),
    ],
    ids=str,
)
def test_mistakes_are_told(quick_fit, boids, arguments, fragment):
    with pytest.raises(InputError) as told:
        analyze(quick_fit, boids, **arguments)
    assert fragment in str(told.value)


def test_a_part_is_one_of_the_fits_own_tracks(quick_fit, boids):
    found = analyze(quick_fit, boids, part="train", draws=1, only=["forces"], scores=False)
    assert found.forces.sizes["trial"] == len(quick_fit.split.part("train"))
    assert "trained on" in found.notes[0]
    others = simulate.simulate_boids(individuals=5, steps=20, trials=1, seed=9)
    with pytest.raises(InputError, match="not the tracks"):
        analyze(quick_fit, others, part="test")
    assert analyze(quick_fit, others, draws=1, only=["forces"], scores=False).notes == ()


def test_what_cannot_be_had_is_left_out_with_a_note():
    space = simulate.simulate_boids(
        individuals=3, steps=30, trials=1, seed=0, observation_noise=0.02
    )
    third = xr.zeros_like(space["position"].isel(space=[0])).assign_coords(space=["z"])
    wave = 0.1 * np.sin(0.3 * np.arange(space.sizes["time"]))
    third = third + xr.DataArray(wave, dims="time")
    tracks = xr.Dataset(
        {"position": xr.concat([space["position"], third], "space")},
        attrs={key: space.attrs[key] for key in ("fps", "time_unit", "unit")},
    ).drop_vars("neighbor", errors="ignore")
    fit = inference.fit("graph-vae", tracks, guide="encoder", epochs=2)
    found = analyze(fit, tracks, draws=1, only=["forces", "force_maps"], part="all", scores=False)
    assert found.force_maps is None
    assert found.forces is not None
    assert any(n.startswith("Left out: force maps. ") and "two" in n for n in found.notes)
    text = analysis_page(found, fit, tracks).html()
    assert "Left out: force maps." in text
    assert HEADINGS["force_maps"] not in text
    with pytest.raises(InputError, match="two dimensions"):
        analyze(fit, tracks, draws=1, only=["force_maps"], part="all", scores=False)


def test_long_recordings_are_thinned_and_say_so(quick_fit, boids, monkeypatch):
    whole = analyze(quick_fit, boids, draws=4, only=["forces"], part="all", scores=False)
    own = sys.modules["swarmssm.analysis.interpretation.analyze"]
    # Four draws of four trials of 60 frames of five individuals: 56 bytes a state.
    needed = 4 * 4 * 60 * 5 * 56
    monkeypatch.setattr(own, "LARGEST", needed // 3 + 1)
    thin = analyze(quick_fit, boids, draws=4, only=["forces"], part="all", scores=False)
    assert thin.forces.attrs["stride"] == 3
    np.testing.assert_array_equal(thin.forces["time"], whole.forces["time"][::3])
    np.testing.assert_array_equal(thin.forces["force"], whole.forces["force"][:, :, ::3])
    np.testing.assert_allclose(thin.forces["explained"], whole.forces["explained"])
    assert "every 3rd frame" in " ".join(thin.notes)


def test_progress_is_told(quick_fit, boids):
    told = []
    analyze(quick_fit, boids, draws=1, only=["forces"], progress=told.append, scores=False)
    assert told == ["paths", "forces"]


def test_the_summary_holds_the_numbers_of_the_datasets(analysis):
    found = analysis.summary()
    share = found.loc[("forces", "share of cohesion")]
    own = analysis.forces["share"].sel(term="cohesion")
    assert share.value == pytest.approx(100 * float(own.sel(quantile=0.5)))
    assert share.low == pytest.approx(100 * float(own.sel(quantile=0.05)))
    assert share.reference.startswith("truth: R²")
    r2 = found.loc[("latents", "R² of cohesion from all latents")]
    linear = analysis.latents.sel(probe="linear", source="latents", term="cohesion")
    assert r2.value == float(linear["source_vector_r2"])
    assert math.isnan(r2.low)
    for row in formatted_summary(analysis.datasets):
        assert list(row) == ["quantity", "value", "90 % interval", "reference"]
        assert all(row.values())


def test_the_page_shows_each_dataset_and_note(analysis, quick_fit, boids):
    text = analysis_page(analysis, quick_fit, boids).html()
    for address in re.findall(r'(?:src|href)="([^"]*)"', text):
        assert address.startswith(("#", "data:")), address
    assert "<script" not in text
    words = html.unescape(text)
    for name in ("forces", "kernels", "force_maps", "latents", "influence"):
        assert HEADINGS[name] in words
    for note in analysis.notes:
        assert note in words
    for row in formatted_summary(analysis.datasets):
        assert row["quantity"] in words
    places = re.findall(r'\bid="([^"]*)"', text)
    assert len(places) == len(set(places))
    assert text.count("<figure>") == text.count("<figcaption>") >= 9


def test_an_empty_analysis_makes_no_page(quick_fit, boids):
    with pytest.raises(InputError, match="nothing to report"):
        analysis_page(Analysis(), quick_fit, boids).html()


def test_other_fits_are_scored_too(quick_fit, boids, tmp_path):
    other = inference.fit("graph-vae", boids, guide="encoder", epochs=1, seed=1)
    found = analyze(
        quick_fit,
        boids,
        draws=1,
        only=["forces"],
        against={"other": other},
        options={"scores": {"horizons": (1, 3), "origins": 5, "draws": 10}},
    )
    alone = score(
        {"graph-vae": quick_fit, "other": other}, boids, horizons=(1, 3), origins=5, draws=10
    )
    xr.testing.assert_equal(found.scores, alone)
    found.write(tmp_path / "a.nc")
    again = Analysis.read(tmp_path / "a.nc")
    np.testing.assert_array_equal(again.scores["log_score"], alone["log_score"])
    assert list(again.scores["model"].to_numpy()) == list(alone["model"].to_numpy())
    assert HEADINGS["comparison"] in analysis_page(again, quick_fit, boids).html()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"scores": False, "options": {"scores": {"origins": 5}}}, "scores: it is off"),
        ({"scores": False, "against": {"other": None}}, "scores: it is off"),
        ({"against": {"graph-vae": None}}, "'graph-vae' is the name of the fit itself"),
    ],
)
def test_scores_that_contradict_are_refused(quick_fit, boids, given, sentence):
    with pytest.raises(InputError, match=sentence):
        analyze(quick_fit, boids, draws=1, only=["forces"], **given)


def test_frames_that_were_held_out_are_judged_by_default(quick_fit, boids):
    found = analyze(
        quick_fit,
        boids,
        draws=1,
        only=["forces", "delays"],
        options={"scores": {"horizons": (1, 3), "origins": 20, "draws": 10}},
    )
    assert found.settings["part"] == "test"
    held_out = [segment.trial for segment in quick_fit.split.part("test")]
    assert [str(name) for name in found.forces["trial"].to_numpy()] == held_out
    assert found.delays.sizes["individual"] == boids.sizes["individual"]
    skills, conclusion = forecast_test(found.scores, "graph-vae")
    assert conclusion in found.verdict()
    assert "should not be believed" in conclusion or any(skill.differs > 0 for skill in skills)


def planted(**skill):
    """Scores of 60 origins in which another model's CRPS is higher by so much at each horizon."""
    swing = np.random.default_rng(0).normal(0.0, 0.1, (60, 1))
    swing -= swing.mean()
    own = np.full((60, 3), 10.0)
    names = ["boids", *(name.replace("_", "-") for name in skill)]
    crps = np.stack([own, *(own + np.asarray(more) + swing for more in skill.values())])
    over = ("model", "origin", "horizon")
    return xr.Dataset(
        {
            "crps": (over, crps, {"units": "cm"}),
            "coverage": ((*over, "level"), np.full((*crps.shape, 1), 0.9), {"units": "1"}),
            "number": (over[1:], np.full((60, 3), 5)),
            "trained_on": ("model", [0] * len(names)),
        },
        {
            "model": names,
            "title": ("model", names),
            "fitted": ("model", [True, *[False] * len(skill)]),
            "horizon": [1, 2, 5],
            "ahead": ("horizon", [0.1, 0.2, 0.5]),
            "level": [0.9],
            "trial": ("origin", ["a"] * 30 + ["b"] * 30),
            "frame": ("origin", 5 * (np.arange(60) % 30)),
        },
    )


@pytest.mark.parametrize(
    ("more", "trained", "origins", "words"),
    [
        ((1.0, 1.0, 1.0), 0, 60, "can be interpreted"),
        ((1.0, 0.0, 0.0), 0, 60, "can be interpreted"),
        ((1.0, 0.0, -1.0), 0, 60, "with reserve"),
        ((0.0, 0.0, 0.0), 0, 60, "should not be believed"),
        ((-1.0, -1.0, -1.0), 0, 60, "should not be believed"),
        ((1.0, 1.0, 1.0), 1, 60, "not tested"),
        ((1.0, 1.0, 1.0), 0, 4, "is not known"),
    ],
)
def test_a_rule_is_believed_if_it_forecasts_better_than_a_baseline(more, trained, origins, words):
    scores = planted(constant_velocity=more).isel(origin=slice(0, origins))
    scores["trained_on"] = scores["trained_on"] + trained
    assert words in forecast_test(scores, "boids")[1]
    assert words in Analysis(scores=scores).verdict()


def test_without_scores_nothing_is_believed(analysis):
    assert "not scored" in Analysis(forces=analysis.forces).verdict()


def test_tables_hold_what_the_figures_show(analysis):
    tables = analysis.to_pandas()
    curve = tables["kernels"].query("kernel == 'net'")
    inside = analysis.kernels.sel(distance=slice(None, analysis.kernels.attrs["believed_to"]))
    np.testing.assert_array_equal(curve["median"], inside["net"].sel(quantile=0.5))
    np.testing.assert_array_equal(curve["truth"], inside["truth_net"])
    shares = tables["forces"].query("quantity == 'share'").set_index("term")
    np.testing.assert_allclose(shares["high"], 100 * analysis.forces["share"].sel(quantile=0.95))
    pair = tables["influence"].query("individual == '1' and neighbor == '0'")
    own = analysis.influence["influence"].sel(individual="1", neighbor="0", quantile=0.5)
    assert pair["median"].item() == float(own)
    assert set(tables["force_maps"]["source"]) == {"model", "raw"}
    assert sum(len(table) for table in tables.values()) < 20_000
    assert not tables["kernels"].isna().any().any()


def test_it_shows_itself_briefly(analysis):
    assert len(repr(analysis)) < 800
    page = analysis._repr_html_()
    assert html.escape(analysis.verdict()) in page
    assert page.count("<tr") == len(analysis.summary()) + 1


def test_an_interval_without_width_is_fixed():
    rows = formatted_summary({"kernels": planted_kernels()})
    assert [row["90 % interval"] for row in rows if row["quantity"] == "kernels: neighbours"] == [
        "fixed"
    ]


def planted_kernels():
    """What the summary reads of kernels, with the same number of neighbours in all draws."""
    ends = {"quantile": [0.05, 0.5, 0.95]}
    data = {
        "neighbors": ("quantile", [9.74] * 3),
        "preferred_distance": ("quantile", [np.nan] * 3),
        "has_preferred_distance": ((), 0.0),
    }
    return xr.Dataset(data, ends, {"unit": "cm", "source": "model"})
