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
from swarmssm.analysis.interpretation.summary import findings, findings_table
from swarmssm.analysis.report.analysis_page import analysis_page, report_analysis
from swarmssm.analysis.scoring.backtest import backtest
from swarmssm.errors import InputError

QUICK = {"latents": {"shifts": 19, "untrained_seeds": 1}}


@pytest.fixture(scope="module")
def analysis(quick_fit, boids):
    return analyze(quick_fit, boids, draws=3, options=QUICK)


@pytest.fixture(scope="module")
def written(analysis, tmp_path_factory):
    """The file of the analysis."""
    path = tmp_path_factory.mktemp("written") / "a.nc"
    analysis.write(path)
    return path


def test_all_is_there_for_a_plain_fit_in_two_dimensions(analysis):
    assert tuple(analysis.datasets) == ANALYSES
    assert tuple(analysis.sentences) == ANALYSES
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
    assert back.sentences == analysis.sentences
    assert back.settings == analysis.settings
    assert back.notes == analysis.notes
    assert findings_table(back) == findings_table(analysis)


def test_anybody_can_open_the_file(analysis, written):
    with xr.open_datatree(written) as tree:
        assert set(tree.children) == set(ANALYSES)
    with xr.open_dataset(written, group="kernels") as kernels:
        np.testing.assert_array_equal(kernels["net"], analysis.kernels["net"])
        assert kernels["net"].attrs["units"]


def test_an_existing_file_is_kept(quick_fit, boids, tmp_path):
    forces = analyze(quick_fit, boids, draws=1, only=["forces"])
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
    found = analyze(quick_fit, boids, part="train", draws=1, only=["forces"])
    assert found.forces.sizes["trial"] == len(quick_fit.split.part("train"))
    assert "trained on" in found.notes[0]
    others = simulate.simulate_boids(individuals=5, steps=20, trials=1, seed=9)
    with pytest.raises(InputError, match="not the tracks"):
        analyze(quick_fit, others, part="test")
    assert analyze(quick_fit, others, draws=1, only=["forces"]).notes == ()


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
    found = analyze(fit, tracks, draws=1, only=["forces", "force_maps"])
    assert found.force_maps is None
    assert found.forces is not None
    assert any(n.startswith("Left out: force maps. ") and "two" in n for n in found.notes)
    text = analysis_page(found, fit, tracks)
    assert "Left out: force maps." in text
    assert "Force maps</h3>" not in text
    with pytest.raises(InputError, match="two dimensions"):
        analyze(fit, tracks, draws=1, only=["force_maps"])


def test_long_recordings_are_thinned_and_say_so(quick_fit, boids, monkeypatch):
    whole = analyze(quick_fit, boids, draws=4, only=["forces"])
    own = sys.modules["swarmssm.analysis.interpretation.analyze"]
    # Four draws of four trials of 60 frames of five individuals: 56 bytes a state.
    needed = 4 * 4 * 60 * 5 * 56
    monkeypatch.setattr(own, "LARGEST", needed // 3 + 1)
    thin = analyze(quick_fit, boids, draws=4, only=["forces"])
    assert thin.forces.attrs["stride"] == 3
    np.testing.assert_array_equal(thin.forces["time"], whole.forces["time"][::3])
    np.testing.assert_array_equal(thin.forces["force"], whole.forces["force"][:, :, ::3])
    np.testing.assert_allclose(thin.forces["explained"], whole.forces["explained"])
    assert "each 3rd frame" in " ".join(thin.notes)


def test_progress_is_told(quick_fit, boids):
    told = []
    analyze(quick_fit, boids, draws=1, only=["forces"], progress=told.append)
    assert told == ["paths", "forces"]


def test_findings_hold_the_numbers_of_the_datasets(analysis):
    found = {(one.analysis, one.quantity): one for one in findings(analysis)}
    share = found["forces", "share of cohesion"]
    own = analysis.forces["share"].sel(term="cohesion")
    assert share.value == pytest.approx(100 * float(own.sel(quantile=0.5)))
    assert share.low == pytest.approx(100 * float(own.sel(quantile=0.05)))
    assert share.beside.startswith("truth: R²")
    r2 = found["latents", "R² of cohesion from all latents"]
    linear = analysis.latents.sel(probe="linear", source="latents", term="cohesion")
    assert r2.value == float(linear["source_vector_r2"])
    assert math.isnan(r2.low)
    for row in findings_table(analysis):
        assert list(row) == ["finding", "value", "90 % interval", "beside it"]
        assert all(row.values())


def test_the_page_is_self_contained_and_says_each_sentence(analysis, quick_fit, boids, tmp_path):
    path = report_analysis(analysis, quick_fit, boids, tmp_path / "a.html")
    text = path.read_text(encoding="utf-8")
    for address in re.findall(r'(?:src|href)="([^"]*)"', text):
        assert address.startswith(("#", "data:image/png;base64,")), address
    for address in re.findall(r"url\(([^)]*)\)", text):
        assert address.startswith("#"), address
    assert "<script" not in text
    assert "<link" not in text
    assert "#000000" not in text.split("</style>")[1]
    words = html.unescape(text)
    for sentence in analysis.sentences.values():
        assert f"<figcaption>{sentence}</figcaption>" in words
    for note in analysis.notes:
        assert note in words
    for row in findings_table(analysis):
        assert row["finding"] in words
    places = re.findall(r'\bid="([^"]*)"', text)
    assert len(places) == len(set(places))
    assert text.count("<figure>") == text.count("<figcaption>") >= 9
    with pytest.raises(InputError, match="exists already"):
        report_analysis(analysis, quick_fit, boids, path)


def test_an_empty_analysis_makes_no_page(quick_fit, boids):
    with pytest.raises(InputError, match="nothing in it"):
        analysis_page(Analysis(), quick_fit, boids)


def test_scores_stand_beside_those_of_rivals(quick_fit, boids, tmp_path):
    other = inference.fit("graph-vae", boids, guide="encoder", epochs=1, seed=1)
    found = analyze(
        quick_fit,
        boids,
        draws=1,
        only=["forces"],
        rivals={"other": other},
        options={"scores": {"horizons": (1, 3), "origins": 5, "draws": 10}},
    )
    alone = backtest(
        {"graph-vae": quick_fit, "other": other}, boids, horizons=(1, 3), origins=5, draws=10
    )
    xr.testing.assert_equal(found.scores, alone)
    assert found.sentences["scores"]
    found.write(tmp_path / "a.nc")
    again = Analysis.read(tmp_path / "a.nc")
    np.testing.assert_array_equal(again.scores["log_score"], alone["log_score"])
    assert list(again.scores["model"].to_numpy()) == list(alone["model"].to_numpy())
    assert "Held-out scores" in analysis_page(again, quick_fit, boids)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"options": {"scores": {"origins": 5}}}, "scores are made only beside rivals"),
        ({"rivals": {"graph-vae": None}}, "'graph-vae' is the name of the fit itself"),
    ],
)
def test_scores_need_rivals_of_other_names(quick_fit, boids, given, sentence):
    with pytest.raises(InputError, match=sentence):
        analyze(quick_fit, boids, draws=1, only=["forces"], **given)
