"""Recovery studies: designs, errors worked by hand, and what a user is told."""

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.diagnostics.recovery import study as module
from swarmssm.analysis.diagnostics.recovery.designs import Design, designs_of, varied_values
from swarmssm.analysis.diagnostics.recovery.study import recovery
from swarmssm.analysis.diagnostics.recovery.table import factor_curve
from swarmssm.errors import InputError

BASE = Design(individuals=3, frames=20, trials=1)
VALUES = {"damping": 0.5, "homing_gain": 0.5, "process_noise": 0.15}


@pytest.fixture
def study(monkeypatch):
    """Return a study whose errors are known: (10, 20, 30 %) times 0.03 / noise * frames / 20."""

    def piece(self, index):
        design = self.designs[index // self.repeats]
        size = 0.1 * (1 + index % self.repeats) * (0.03 / design.noise) * 20 / design.frames
        if design.frames == 80 and index % self.repeats == 2:
            return {"failed": "fit: no maximum"}
        row = {"truth": {"transition.cohesion_gain": -2.0, "transition.center[0]": 0.0}}
        row["median"] = {"transition.cohesion_gain": -2.0 * (1 + size), "transition.center[0]": 1.0}
        row["sd"] = dict.fromkeys(row["truth"], 0.4)
        row["low"] = {name: value - 0.5 for name, value in row["median"].items()}
        row["high"] = {name: value + 0.5 for name, value in row["median"].items()}
        return {**row, "seconds": 1.0}

    monkeypatch.setattr(module._Recover, "__call__", piece)

    def run(**options):
        given = {"factors": {"frames": [10, 40, 80], "noise": [0.06]}, "datasets": 3, **options}
        return recovery("linear", base=BASE, values=VALUES, **given)

    return run


def test_errors_worked_by_hand(study):
    found = study().data
    gain = found.sel(parameter="transition.cohesion_gain")
    assert found["label"].values.tolist() == [
        "base",
        "frames 10",
        "frames 40",
        "frames 80",
        "noise 0.06",
    ]
    # Medians of (1, 2, 3) times 10 %; of the first two where the third failed.
    assert gain["error"].values == pytest.approx([0.2, 0.4, 0.1, 0.0375, 0.1])
    # Estimates lie below a negative truth.
    assert gain["bias"].values == pytest.approx([-0.2, -0.4, -0.1, -0.0375, -0.1])
    # Half the interval is 0.5, of a truth of 2.
    assert gain["width"].values == pytest.approx(0.25)
    # Off by 0.2 of 2 is within 0.5, by 0.6 not.
    assert gain["coverage"].values == pytest.approx([2 / 3, 1 / 3, 1.0, 1.0, 1.0])
    # Standard deviations of 20 %: four times the frames for 10 %.
    assert gain["frames_needed"].values == pytest.approx([80, 40, 160, 320, 80])
    assert found["fitted"].values.tolist() == [3, 3, 3, 2, 3]
    assert found.attrs["failed"] == 1
    assert found.attrs["failures"] == "1 x fit: no maximum"
    middle = found.sel(parameter="transition.center[0]")
    assert np.isnan(middle["error"]).all()


def test_summary_and_verdict(study):
    found = study()
    sufficient = found.sufficient()
    assert sufficient["cohesion_gain"].tolist() == ["40 or more", "0.06 or more"]
    assert sufficient["center[0]"].tolist() == ["none", "none"]
    rows = found.summary().xs("transition.cohesion_gain", level="parameter")
    assert rows["error"].tolist() == pytest.approx([0.2, 0.4, 0.1, 0.0375, 0.1])
    assert rows["within_tolerance"].tolist() == [False, False, True, True, True]
    assert len(found.to_pandas()) == 5 * 2 * 3
    verdict = found.verdict()
    assert verdict.startswith("Not all gains are recovered to within 10 %")
    assert "largest median error 20 %" in verdict
    assert "about 80 frames a trial" in verdict
    assert study(tolerance=0.5).verdict().startswith("All gains are recovered to within 50 %")


def test_a_curve_holds_the_base_in_its_place(study):
    curve = factor_curve(study().data, "frames")
    assert curve["frames"].values.tolist() == [10, 20, 40, 80]


def test_a_grid_holds_all_combinations(study):
    result = study(factors={"frames": [10, 20], "noise": [0.03, 0.06]}, grid=True)
    found = result.data
    pairs = list(zip(found["frames"].values.tolist(), found["noise"].values.tolist(), strict=True))
    assert pairs == [(10, 0.03), (10, 0.06), (20, 0.03), (20, 0.06)]
    assert result.sufficient().empty


def test_multiples_of_the_base():
    varied = varied_values(["frames", "noise"], Design())
    assert varied["frames"] == [50, 100, 200, 400]
    assert varied["noise"] == pytest.approx([0.01, 0.03, 0.09])
    labels, chosen = designs_of(varied, Design(), grid=False)
    # The base is there once.
    assert len(chosen) == 1 + 3 + 2
    assert labels[0][0] == "base"


def test_a_simulation_is_what_its_design_says():
    design = Design(individuals=40, density=2.5, radius=2.0, noise=0.1, frames=5, trials=3)
    work = module._Recover("linear", "auto", (design,), 1, None, VALUES, None, {}, 0)
    tracks, truth = work.simulate(design, 0)
    assert dict(tracks.sizes) == {"trial": 3, "time": 5, "space": 2, "individual": 40}
    assert {name: float(truth[f"transition.{name}"]) for name in VALUES} == VALUES
    assert float(truth["emission.noise"]) == 0.1
    assert float(truth["transition.cohesion_gain"]) == 0.6
    # 40 at 2.5 in a unit of area: a square of side 4, with noise of 0.1.
    first = tracks["position"].isel(time=0)
    spread = first.std(("trial", "individual")).to_numpy()
    # The deviation of uniform numbers has a relative error of sqrt(0.8 / 4 n).
    wanted = np.sqrt(16 / 12 + 0.01)
    assert spread == pytest.approx([wanted, wanted], rel=6 * np.sqrt(0.2 / 120))
    options, graph = work.edges(design)
    assert (options, graph) == ({"edges": "radius:2.0"}, None)


def test_found_again_from_simulated_data(tmp_path):
    out = tmp_path / "recovery.jsonl"
    options = {
        "factors": {"noise": [0.2]},
        "base": Design(individuals=3, frames=20, trials=1, noise=0.02),
        "datasets": 1,
        "values": VALUES | {"cohesion_gain": 1.0, "alignment_gain": 1.0},
    }
    found = recovery("linear", out=out, **options).data
    noise = found.sel(parameter="emission.noise")
    # 120 numbers tell their noise to 1 / sqrt(2 * 120) = 6.5 %, and paths take up some of them.
    assert (noise["error"] < 6 * 0.065).all()
    assert noise["truth"].values.tolist() == [[0.02], [0.2]]
    assert isinstance(found, xr.Dataset)
    again = recovery("linear", out=out, resume=True, **options).data
    assert again.identical(found)
    with pytest.raises(InputError, match=r"other settings \(values\)"):
        recovery("linear", out=out, resume=True, **{**options, "values": VALUES})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"factors": {"weather": [1]}}, "there is no weather"),
        ({"factors": ["weather"]}, "there is no weather"),
        ({"factors": "frames"}, "list of names"),
        ({"factors": {"frames": []}}, "frames has no values"),
        ({"factors": {"frames": [3]}}, "frames: it must be a whole number from 4"),
        ({"factors": {"frames": [10.5]}}, "frames: it must be a whole number"),
        ({"factors": {"noise": [0]}}, "noise: it must be a number above 0"),
        ({"factors": {"noise": [float("nan")]}}, "noise"),
        ({"datasets": 0}, "datasets"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"values": {"charm": 1.0}}, "charm is the name of no parameter"),
        ({"values": {"damping": -1.0}}, "damping"),
        ({"model": "graph-vae"}, "no state-space model"),
        ({"graph": "nonsense"}, "nonsense"),
        ({"base": Design(radius=None)}, "the base has no radius"),
    ],
)
def test_mistakes(options, words):
    given = {"model": "linear", "base": BASE, "factors": {"frames": [10]}, "datasets": 1, **options}
    with pytest.raises(InputError, match=words):
        recovery(**given)


def test_errors_of_a_place_are_relative_to_the_box():
    names = ["t.half_width[0]", "t.half_width[1]", "t.center[0]", "t.center[1]", "t.gain", "t.off"]
    truth = np.array([2.0, 4.0, 0.01, 0.0, -0.5, 0.0]).reshape(1, 6, 1)
    expected = [2.0, 4.0, 2.0, 4.0, 0.5, np.nan]
    np.testing.assert_array_equal(module._sizes(names, truth)[0, :, 0], expected)
