"""Posterior forces: those of the simulator, by hand, projected; their summaries."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr

from swarmssm import simulate
from swarmssm.analysis.interpretation.forces.posterior import (
    TERMS,
    force_summary,
    posterior_forces,
)
from swarmssm.analysis.interpretation.forces.truth import force_agreement, true_forces
from swarmssm.analysis.posterior.accelerations import acceleration_model
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.models import LatentEdges
from swarmssm.tracks import make_tracks

Make = Callable[..., Any]
LIMITS = {"min_speed": 0.6, "max_speed": 1.2}
WALL = {"wall_gain": 1.0, "half_width": 4.0}
#: Tracks enter a model in single precision: coordinates of up to 8 are known to 5e-7, and a
#: velocity of up to 2 divided by the time step of 0.1 to 1.2e-6.
SINGLE = 1e-5


@pytest.fixture(scope="module")
def walled() -> xr.Dataset:
    """Boids between walls, with limits of speed."""
    return simulate.simulate_boids(6, 120, 2, seed=0, process_noise=0.0)


def test_forces_of_the_true_law_are_those_of_the_simulator(
    walled: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    fit = make_fit(walled, make_law(**WALL, **LIMITS))
    forces = posterior_forces(fit, walled, draws=2)
    truth = true_forces(walled)
    assert forces["force"].dims[1:] == truth["force"].dims
    assert float(np.abs(truth["force"].sel(term="self")).max()) > 0.1
    assert float(np.abs(truth["force"].sel(term="other")).max()) > 0.1
    np.testing.assert_allclose(
        forces["force"].mean("draw").to_numpy(), truth["force"].to_numpy(), atol=SINGLE
    )
    agreement = force_agreement(forces, truth)
    np.testing.assert_allclose(agreement["r_squared"], 1.0, atol=1e-8)
    assert forces.attrs["source"] == "model"
    assert forces["force"].attrs["units"] == "length units/s^2"


def test_velocities_of_the_velocity_form_become_accelerations(
    make_fit: Make, make_law: Make
) -> None:
    tracks = simulate.simulate_boids(5, 40, form="velocity", seed=2, process_noise=0.01)
    gains = {"cohesion_gain": 0.5, "separation_gain": 0.3, "alignment_gain": 0.95}
    fit = make_fit(tracks, make_law(form="velocity", **gains))
    forces = posterior_forces(fit, tracks, draws=1)
    force, velocity = forces["force"].isel(draw=0), forces["velocity"].isel(draw=0)
    np.testing.assert_allclose(force.sel(term="self"), -velocity / 0.1, atol=1e-5)
    # What is a velocity to the simulator is ten times as much an acceleration.
    np.testing.assert_allclose(
        force.sel(term="cohesion").to_numpy(),
        10 * tracks["force"].sel(term="cohesion").transpose(*force.dims[:-1]).to_numpy(),
        atol=10 * SINGLE,
    )
    np.testing.assert_allclose(
        force.to_numpy(), true_forces(tracks)["force"].to_numpy(), atol=20 * SINGLE
    )


def test_two_individuals_by_hand(make_fit: Make, make_law: Make) -> None:
    position = np.array([[[0.0, 0.0], [2.0, 0.0]]] * 2)
    velocity = np.array([[[1.0, 0.0], [0.0, 1.0]]] * 2)
    both = np.array([[[0, 1], [1, 0]]] * 2)
    tracks = make_tracks(position, fps=10, velocity=velocity, adjacency=both, unit="cm")
    fit = make_fit(tracks, make_law(relaxation_gain=0.25, preferred_speed=3.0))
    forces = posterior_forces(fit, tracks, draws=1)
    first = forces["force"].isel(draw=0, trial=0, time=0, individual=0)
    expected = {
        "cohesion": (0.5 * 2, 0.0),
        "separation": (-0.3 / 2, 0.0),
        "alignment": (-0.2, 0.2),
        "self": (0.25 * (3.0 - 1.0), 0.0),
        "other": (0.0, 0.0),
    }
    for term, value in expected.items():
        np.testing.assert_allclose(first.sel(term=term), value, atol=1e-6)
    assert forces["force"].attrs["units"] == "cm/s^2"
    assert forces["explained"].item() == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["boids", "nameless", "graph-vae"])
def test_terms_add_up_to_the_expected_acceleration(
    name: str,
    walled: xr.Dataset,
    quick_fit: Fit,
    make_fit: Make,
    make_law: Make,
    nameless: Any,
    expected: Make,
) -> None:
    if name == "graph-vae":
        fit = quick_fit
    else:
        kind = {"kind": nameless} if name == "nameless" else {}
        fit = make_fit(walled, make_law(**kind, **WALL, **LIMITS, noise="multiplicative"))
    forces = posterior_forces(fit, walled, draws=1)
    whole = expected(acceleration_model(fit), fit, walled)
    size = float(whole.abs().max())
    summed = forces["force"].isel(draw=0).sum("term", skipna=False).to_numpy()
    np.testing.assert_allclose(summed, whole.numpy(), atol=2e-5 * max(size, 1.0))
    assert forces.attrs["source"] == ("model" if name == "boids" else "projection")


def test_projection_finds_the_gains_of_a_law_without_names(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    fit = make_fit(packed_boids, make_law(nameless))
    # The push of (3.17) is bounded at the estimated tracking noise, which is next to none here.
    assert fit.scales.noise < 1e-3
    forces = posterior_forces(fit, packed_boids, draws=2)
    mean = forces["coefficient"].mean("draw")
    for name, value in (("cohesion", 0.5), ("separation", 0.3), ("alignment", 0.2)):
        assert float(mean.sel(column=name)) == pytest.approx(value, abs=1e-4)
    for name in ("velocity", "heading", "offset"):
        assert abs(float(mean.sel(column=name))) < 1e-3
    np.testing.assert_allclose(forces["explained"], 1.0, atol=1e-6)
    truth = true_forces(packed_boids)
    agreement = force_agreement(forces, truth).sel(term=["cohesion", "separation", "alignment"])
    assert float(agreement["r_squared"].min()) > 0.9999
    assert forces["column_units"].sel(column="separation") == "length units^2/s^2"


def test_what_the_boids_terms_do_not_explain_is_other(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    # A push with the fourth power of the distance is none of the terms.
    fit = make_fit(packed_boids, make_law(nameless, exponent=4.0))
    forces = posterior_forces(fit, packed_boids, draws=1)
    other = np.square(forces["force"].sel(term="other").to_numpy()).sum()
    whole = np.square(forces["force"].sum("term").to_numpy()).sum()
    assert 0.02 < other / whole < 0.98
    assert forces["explained"].item() == pytest.approx(1 - other / whole, rel=1e-5)
    # Least squares: what is left over is orthogonal to what was fitted.
    rest = forces["force"].sel(term="other").to_numpy().ravel()
    for term in ("cohesion", "separation", "alignment"):
        part = forces["force"].sel(term=term).to_numpy().ravel()
        assert abs(rest @ part) < 1e-4 * np.linalg.norm(rest) * np.linalg.norm(part)


@pytest.mark.parametrize("projected", [False, True])
def test_the_graph_is_that_of_the_model(
    projected: bool, packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    tracks = packed_boids.drop_vars("adjacency")
    kind = {"kind": nameless} if projected else {}
    fit = make_fit(tracks, make_law(**kind), edges=LatentEdges("radius:2.5"), graph="complete")
    agreement = force_agreement(posterior_forces(fit, tracks, 1), true_forces(packed_boids))
    assert float(agreement["r_squared"].sel(term=["cohesion", "alignment"]).min()) > 0.9999


def test_a_radius_of_the_model_itself_narrows_the_graph(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any
) -> None:
    tracks = packed_boids.drop_vars("adjacency")
    fit = make_fit(tracks, make_law(nameless, radius=2.5), graph="complete")
    forces = posterior_forces(fit, tracks, draws=1)
    np.testing.assert_allclose(forces["explained"], 1.0, atol=1e-6)


def test_turned_and_renamed_tracks_have_turned_and_renamed_forces(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    order = [3, 0, 5, 1, 4, 2]
    position, velocity = (
        packed_boids[name].transpose("trial", "time", "individual", "space").to_numpy()
        for name in ("position", "velocity")
    )
    adjacency = packed_boids["adjacency"].to_numpy()
    moved = make_tracks(
        position[:, :, order] @ turn.T,
        fps=10,
        velocity=velocity[:, :, order] @ turn.T,
        adjacency=adjacency[:, :, order][..., order],
    )
    plain = posterior_forces(make_fit(packed_boids, make_law()), packed_boids, 1)
    other = posterior_forces(make_fit(moved, make_law()), moved, 1)
    over = ("trial", "time", "individual", "term", "space")
    first, second = (f["force"].isel(draw=0).transpose(*over).to_numpy() for f in (plain, other))
    np.testing.assert_allclose(second, first[:, :, order] @ turn.T, atol=5e-5)


def test_three_dimensions(make_fit: Make, make_law: Make) -> None:
    tracks = simulate.simulate_boids(5, 30, space=3, seed=4, process_noise=0.0)
    forces = posterior_forces(make_fit(tracks, make_law(space=3, **WALL, **LIMITS)), tracks, 1)
    np.testing.assert_allclose(
        forces["force"].isel(draw=0), true_forces(tracks)["force"], atol=SINGLE
    )
    summary = force_summary(forces)
    assert "angle" not in summary
    between = summary["angle_to_heading"].to_numpy()
    assert np.nanmin(between) >= 0
    assert np.nanmax(between) <= np.pi


def test_who_is_absent_has_no_force(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make
) -> None:
    tracks = packed_boids[["position", "velocity", "adjacency"]].copy(deep=True)
    for name in ("position", "velocity"):
        tracks[name][{"trial": 0, "time": slice(10, 20), "individual": 2}] = np.nan
    forces = posterior_forces(make_fit(tracks, make_law()), tracks, 1)
    absent = np.isnan(forces["force"].to_numpy()).all((-2, -1))
    assert absent[0, 0, 10:20, 2].all()
    assert absent.sum() == 10
    summary = force_summary(forces)
    assert np.isfinite(summary["group_magnitude"].to_numpy()).all()
    assert np.isnan(summary["magnitude"].to_numpy()[:, 0, 12, 2]).all()


def planted(force: np.ndarray, velocity: np.ndarray) -> xr.Dataset:
    """Return forces ``(draw, space)`` of one individual in one frame, as cohesion alone."""
    draws = len(force)
    values = np.zeros((draws, 1, 1, 1, 2, len(TERMS)))
    values[..., 0, 0, 0, :, 0] = force
    dims = ("draw", "trial", "time", "individual", "space")
    return xr.Dataset(
        {
            "force": ((*dims, "term"), values, {"units": "cm/s^2"}),
            "velocity": (dims, np.broadcast_to(velocity, (draws, 1, 1, 1, 2))),
            "explained": ("draw", np.ones(draws)),
        },
        {"trial": ["0"], "time": [0.0], "individual": ["a"], "space": ["x", "y"], "term": [*TERMS]},
        {"source": "model"},
    )


def test_summary_of_magnitudes_and_angles_by_hand() -> None:
    summary = force_summary(planted(np.array([[0.0, 5.0]] * 3), np.array([2.0, 0.0])))
    first = summary.isel(trial=0, time=0, individual=0).sel(term="cohesion")
    np.testing.assert_allclose(first["magnitude"], 5.0)
    np.testing.assert_allclose(first["angle"], np.pi / 2)
    np.testing.assert_allclose(first["angle_to_heading"], np.pi / 2)
    np.testing.assert_allclose(summary["share"].sel(quantile=0.5), [1, 0, 0, 0, 0])
    assert np.isnan(summary["angle"].sel(term="other").to_numpy()).all()
    assert summary["magnitude"].attrs["units"] == "cm/s^2"
    turned = force_summary(planted(np.array([[0.0, 5.0]] * 3), np.array([0.0, 2.0])))
    np.testing.assert_allclose(turned["angle_to_heading"].sel(term="cohesion"), 0.0, atol=1e-12)


def test_angles_on_both_sides_of_the_seam_are_near_each_other() -> None:
    # Of 39 draws, ranks 2 and 38 are the ends of the 90 % interval.
    angle = np.pi + np.linspace(-0.19, 0.19, 39)
    force = np.stack([np.cos(angle), np.sin(angle)], -1)
    summary = force_summary(planted(force, np.array([1.0, 0.0])))
    low, middle, high = summary["angle"].sel(term="cohesion").to_numpy().ravel()
    assert abs(abs(middle) - np.pi) < 1e-9
    assert high - low == pytest.approx(0.36)
    assert middle - low == pytest.approx(0.18)


def test_agreement_of_well_calibrated_draws() -> None:
    rng = np.random.default_rng(0)
    count, draws = 4000, 40
    centre = rng.normal(size=count)
    truth = centre + 0.5 * rng.normal(size=count)
    drawn = centre + 0.5 * rng.normal(size=(draws, count))
    dims = ("trial", "time", "individual", "space", "term")
    coords = {"trial": ["0"], "individual": ["a"], "space": ["x"], "term": ["cohesion"]}
    forces = xr.Dataset(
        {"force": (("draw", *dims), drawn[:, None, :, None, None, None])},
        {**coords, "time": np.arange(count)},
    )
    true = xr.Dataset(
        {"force": (dims, truth[None, :, None, None, None])}, {**coords, "time": np.arange(count)}
    )
    found = force_agreement(forces, true)
    # Standard deviations: sqrt(0.9 * 0.1 / 4000), and about 2 * 0.2 / sqrt(4000) of R^2.
    assert found["coverage"].item() == pytest.approx(0.9, abs=6 * 0.0048)
    noise = 0.25 + 0.25 / draws
    assert found["r_squared"].item() == pytest.approx(1 - noise / 1.25, abs=6 * 0.0063)
    shifted = force_agreement(forces.isel(time=slice(0, 100)), true)
    assert np.isfinite(shifted["r_squared"].item())
    with pytest.raises(InputError, match="no trial"):
        force_agreement(forces.assign_coords(time=forces["time"] + 0.5), true)


def test_no_true_forces() -> None:
    with pytest.raises(InputError, match="no true forces"):
        true_forces(make_tracks(np.zeros((3, 2, 2)), fps=1))
    with pytest.raises(InputError, match="couzin"):
        true_forces(simulate.simulate_couzin(3, 5))


def test_true_forces_of_a_part_of_the_frames(walled: xr.Dataset) -> None:
    whole, part = true_forces(walled), true_forces(walled.isel(time=slice(30, 40)))
    np.testing.assert_allclose(part["force"], whole["force"].isel(time=slice(30, 40)))


def test_draws_must_be_positive(walled: xr.Dataset, make_fit: Make, make_law: Make) -> None:
    with pytest.raises(InputError, match="draws"):
        posterior_forces(make_fit(walled, make_law()), walled, 0)


def test_everything_goes_into_one_file(
    packed_boids: xr.Dataset, make_fit: Make, make_law: Make, nameless: Any, tmp_path: Any
) -> None:
    forces = posterior_forces(make_fit(packed_boids, make_law(nameless)), packed_boids, 2)
    forces.to_netcdf(tmp_path / "forces.nc", engine="h5netcdf")
    force_summary(forces).to_netcdf(tmp_path / "summary.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "forces.nc", engine="h5netcdf") as read:
        xr.testing.assert_equal(read["force"], forces["force"])


def test_gradients_are_not_kept(walled: xr.Dataset, make_fit: Make, make_law: Make) -> None:
    fit = make_fit(walled, make_law(cohesion_gain=torch.nn.Parameter(torch.tensor(0.5))))
    assert posterior_forces(fit, walled, 1)["force"].notnull().all()
