"""What a notebook holds is fitted as it is: arrays, tables, and several recordings at once."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from swarmssm import io
from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.simulate import simulate_boids
from swarmssm.tracks import make_tracks


@pytest.fixture(scope="module")
def pair():
    """Two recordings of different length and number of individuals."""
    return [
        simulate_boids(individuals=n, steps=t, seed=n).isel(trial=0, drop=True)
        for n, t in ((4, 40), (5, 30))
    ]


def tidy(tracks: xr.Dataset) -> pd.DataFrame:
    table = tracks["position"].to_dataset("space").to_dataframe().reset_index()
    return table.rename(columns={"individual": "id"}).sample(frac=1, random_state=0)


def test_recordings_are_pooled_as_trials(pair):
    pooled = io.as_tracks({"a": pair[0], "b": pair[1]})
    assert dict(pooled.sizes) == {
        "trial": 2,
        "time": 40,
        "space": 2,
        "individual": 5,
        "neighbor": 5,
    }
    assert pooled["trial"].values.tolist() == ["a", "b"]
    for name, tracks in zip("ab", pair, strict=True):
        part = pooled.sel(trial=name, individual=tracks["individual"])
        part = part.isel(time=slice(tracks.sizes["time"]))
        np.testing.assert_array_equal(
            part["position"], tracks["position"].transpose(*part["position"].dims)
        )
        own = part["adjacency"].sel(neighbor=tracks["neighbor"])
        np.testing.assert_array_equal(own, tracks["adjacency"].transpose(*own.dims))
    assert pooled["position"].sel(trial="b").isel(time=slice(30, None)).isnull().all()
    assert pooled["position"].sel(trial="a", individual="4").isnull().all()


def test_equal_trial_names_are_told_apart(swarm):
    assert io.as_tracks([swarm, swarm])["trial"].values.tolist() == ["0/0", "0/1", "1/0", "1/1"]
    renamed = swarm.assign_coords(trial=["x", "y"])
    assert io.as_tracks([swarm, renamed])["trial"].values.tolist() == ["0", "1", "x", "y"]


def test_a_fit_of_pooled_recordings_is_that_of_their_tracks(pair):
    options = {"steps": 2, "window": 10, "seed": 1, "split_by": "time"}
    table = fit("linear", pair, **options).summary()
    pooled = fit("linear", io.as_tracks(pair), **options).summary()
    pd.testing.assert_frame_equal(table, pooled)


def test_a_table_and_an_array_are_the_tracks(pair):
    one = pair[0]
    from_table = io.as_tracks(tidy(one), unit="cm")
    np.testing.assert_allclose(from_table["position"], one["position"])
    assert (from_table.attrs["fps"], from_table.attrs["unit"]) == (10.0, "cm")
    position = one["position"].transpose("time", "individual", "space").to_numpy()
    from_array = io.as_tracks(position, fps=10.0)
    xr.testing.assert_equal(from_array, make_tracks(position, fps=10.0))
    indexed = io.as_tracks(tidy(one).set_index(["time", "id"]))
    np.testing.assert_array_equal(indexed["position"], from_table["position"])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda a, b: [], "the list of recordings is empty"),
        (lambda a, b: [a, b.assign_attrs(unit="cm")], "unit: recording 0 has no unit and 1 has cm"),
        (
            lambda a, b: [a, b.isel(time=slice(None, None, 2)).assign_attrs(fps=5.0)],
            "fps: recording 0 has 10 frames per second and 1 has 5",
        ),
        (lambda a, b: [a, b.drop_vars("velocity")], "velocity: only one of the recordings 0 and 1"),
        (lambda a, b: {"a": a, "b": np.zeros((9, 2, 2))}, "fps: an array has no frame rate"),
        (lambda a, b: [1.0, 2.0], "float is no recording"),
        (lambda a, b: tidy(a).drop(columns="x"), "DataFrame: it has a column y but no column x"),
        (lambda a, b: tidy(a).assign(x="left"), "DataFrame: column 'x' holds"),
    ],
)
def test_what_is_no_recording_is_told_in_a_sentence(pair, change, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        fit("boids", change(*pair))
    assert len(str(caught.value).splitlines()) == 1


def test_a_rate_that_contradicts_the_tracks_is_refused(pair):
    with pytest.raises(InputError, match=r"fps: 25 is given, and the tracks say 10\.0"):
        io.as_tracks(pair[0], fps=25)


def test_a_model_without_a_name_writes_no_run_folder(swarm, tmp_path):
    def inside(scales):
        raise AssertionError("never built")

    for model in (lambda scales: None, inside):
        with pytest.raises(InputError, match="model: a run folder stores its name"):
            fit(model, swarm, out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
