import filterpy.common
import filterpy.kalman
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmssm.errors import InputError
from swarmssm.tracks import Array, kinematics, make_tracks, states_of, stepwise_velocity
from swarmssm.tracks.kinematics import add_velocity, estimate_noise, observed_runs, smooth_positions

NAN = np.nan


def simulate(
    shape: tuple[int, int, int], fps: float, q: float, r: float, seed: int, speed: float = 1.0
) -> tuple[Array, Array]:
    """Draw tracks from the smoother's own model.

    Returns observed positions and true velocities, each of shape (time, individual, space).
    """
    generator = np.random.default_rng(seed)
    dt = 1.0 / fps
    place, velocity = np.zeros(shape), np.zeros(shape)
    velocity[0] = generator.normal(0.0, speed, shape[1:])
    for t in range(shape[0] - 1):
        push = generator.normal(0.0, q, shape[1:])
        place[t + 1] = place[t] + dt * velocity[t] + 0.5 * dt**2 * push
        velocity[t + 1] = velocity[t] + dt * push
    return place + generator.normal(0.0, r, shape), velocity


def dense_posterior(run: Array, fps: float, q: float, r: float) -> Array:
    """Return the conditional mean of the joint Gaussian of a whole run, without any recursion.

    The path is linear in the first place and velocity (flat) and the accelerations; their
    posterior mean is that of one weighted least-squares problem.
    """
    length, dt = len(run), 1.0 / fps
    place, velocity = np.zeros((2, length, length + 1))
    place[:, 0], velocity[0, 1], place[0, 1] = 1.0, 1.0, 0.0
    for t in range(length - 1):
        place[t + 1] = place[t] + dt * velocity[t]
        place[t + 1, t + 2] += 0.5 * dt**2
        velocity[t + 1] = velocity[t]
        velocity[t + 1, t + 2] += dt
    prior = np.concatenate([np.zeros((length - 1, 2)), np.eye(length - 1) / q], axis=1)
    design = np.concatenate([place / r, prior])
    target = np.concatenate([run / r, np.zeros((length - 1, run.shape[1]))])
    unknown = np.linalg.lstsq(design, target, rcond=None)[0]
    return np.concatenate([place @ unknown, velocity @ unknown], axis=-1)


def filterpy_smoother(run: Array, fps: float, q: float, r: float) -> tuple[Array, Array]:
    """Return filterpy's smoothed means and covariances, of a state ``[x, y, vx, vy]``."""
    space = run.shape[1]
    identity = np.eye(space)
    judge = filterpy.kalman.KalmanFilter(dim_x=2 * space, dim_z=space)
    judge.F = np.kron([[1.0, 1.0 / fps], [0.0, 1.0]], identity)
    judge.H = np.kron([[1.0, 0.0]], identity)
    judge.R = r**2 * identity
    noise = filterpy.common.Q_discrete_white_noise(dim=2, dt=1.0 / fps, var=q**2)
    judge.Q = np.kron(noise, identity)
    # The first position and difference, of which next to nothing was known, are the prior.
    mean = np.concatenate([run[0], (run[1] - run[0]) * fps])
    spread = 1e6 * (2 * (r * fps) ** 2 + 0.25 * (q / fps) ** 2)
    covariance = np.diag([r**2] * space + [spread] * space)
    judge.x, judge.P = mean, covariance
    means, covariances, _, _ = judge.batch_filter(list(run[1:]))
    smoothed, variances, _, _ = judge.rts_smoother(
        np.concatenate([mean[None], means]), np.concatenate([covariance[None], covariances])
    )
    return smoothed, variances


# --- the smoother ------------------------------------------------------------------------------


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("length", [2, 3, 20])
@pytest.mark.parametrize(
    ("fps", "q", "r"), [(25.0, 3.0, 0.05), (1.0, 0.2, 5.0), (10.0, 50.0, 1e-3), (0.1, 1e-3, 1.0)]
)
def test_smoothed_means_are_those_of_the_joint_gaussian(
    space: int, length: int, fps: float, q: float, r: float
):
    position, _ = simulate((length, 3, space), fps, q, r, seed=length)
    smoothed = smooth_positions(position, fps, process_noise=q, observation_noise=r)
    assert smoothed.shape == (length, 3, 2 * space)
    for i in range(3):
        truth = dense_posterior(position[:, i], fps, q, r)
        scale = np.abs(truth).max(axis=0)
        # The velocity that a run begins with has a millionth of the weight of what is observed.
        np.testing.assert_allclose(smoothed[:, i] / scale, truth / scale, rtol=0, atol=1e-5)


def test_smoothed_means_are_those_of_filterpy_in_every_run_of_every_trial():
    position = np.stack([simulate((120, 5, 2), 25, 3, 0.05, seed)[0] for seed in (1, 2)])
    generator = np.random.default_rng(0)
    position[generator.random(position.shape[:3]) < 0.08] = NAN
    position[0, :, 2] = NAN
    smoothed = smooth_positions(position, 25.0, process_noise=3.0, observation_noise=0.05)
    checked = 0
    for b, i in np.ndindex(2, 5):
        seen = np.isfinite(position[b, :, i, 0])
        assert np.isnan(smoothed[b, ~seen, i]).all()
        for start, stop in observed_runs(seen):
            if stop - start == 1:
                assert np.isnan(smoothed[b, start, i]).all()
                continue
            truth, _ = filterpy_smoother(position[b, start:stop, i], 25.0, 3.0, 0.05)
            np.testing.assert_allclose(smoothed[b, start:stop, i], truth, rtol=0, atol=1e-10)
            checked += 1
    assert checked > 60


def test_the_causal_velocity_is_the_last_smoothed_one_of_its_history():
    position, _ = simulate((40, 3, 2), 25, 3, 0.05, seed=7)
    position[12:15, 1] = NAN
    noise = {"process_noise": 3.0, "observation_noise": 0.05}
    causal = smooth_positions(position, 25.0, causal=True, **noise)
    for stop in (2, 9, 17, 30, 40):
        history = smooth_positions(position[:stop], 25.0, **noise)
        np.testing.assert_allclose(causal[stop - 1], history[-1], rtol=1e-9)
    # The first frame of a run is known by its second alone.
    assert np.isnan(causal[[0, 15], 1]).all()


def test_small_noise_loses_few_digits():
    position, _ = simulate((40, 1, 2), 25.0, 10.0, 0.1, seed=0)
    noise = {"process_noise": 1e-5, "observation_noise": 1e-7}
    truth = dense_posterior(position[:, 0], 25.0, *noise.values())
    scale = np.abs(truth).max(axis=0)
    smoothed = smooth_positions(position, 25.0, **noise)[:, 0]
    np.testing.assert_allclose(smoothed / scale, truth / scale, rtol=0, atol=1e-5)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_nothing_is_carried_across_a_gap_nor_between_individuals_or_trials(seed: int, cut: int):
    position = simulate((41, 4, 2), 10, 1.0, 0.1, seed)[0].reshape(41, 2, 2, 2).swapaxes(0, 1)
    position[0, cut - 1, 0] = NAN
    noise = {"process_noise": 1.0, "observation_noise": 0.1}
    before = smooth_positions(position, 10.0, **noise)
    disturbed = position.copy()
    disturbed[0, cut:, 0] += 1e3 * np.arange(41 - cut)[:, None] ** 2
    after = smooth_positions(disturbed, 10.0, **noise)
    np.testing.assert_array_equal(after[0, :cut, 0], before[0, :cut, 0])
    np.testing.assert_array_equal(after[0, :, 1], before[0, :, 1])
    np.testing.assert_array_equal(after[1], before[1])


def test_large_tracks_smoothed_in_groups_are_the_same(monkeypatch: pytest.MonkeyPatch):
    position = np.stack([simulate((30, 7, 2), 10, 1.0, 0.1, seed)[0] for seed in range(3)])
    whole = smooth_positions(position, 10.0)
    monkeypatch.setattr(kinematics, "GROUP_SIZE", 30 * 8 * 2)  # two individuals at a time
    np.testing.assert_array_equal(smooth_positions(position, 10.0), whole)
    monkeypatch.setattr(kinematics, "GROUP_SIZE", 1)
    np.testing.assert_array_equal(smooth_positions(position, 10.0), whole)


def test_runs_of_one_frame_have_no_velocity():
    position = np.full((6, 2, 2), NAN)
    position[[0, 2, 3, 5], 0] = [[0, 0], [1, 1], [2, 1], [9, 9]]
    smoothed = smooth_positions(position, 1.0, process_noise=1.0, observation_noise=1e-4)
    assert np.isnan(smoothed[[0, 1, 4, 5], 0]).all()
    assert np.isnan(smoothed[:, 1]).all()
    # Two frames: the velocity is their difference.
    assert np.isfinite(smoothed[2:4, 0]).all()
    np.testing.assert_allclose(smoothed[2:4, 0, :2], position[2:4, 0], rtol=0, atol=1e-3)


def test_kalman_velocities_err_less_than_differences_as_theory_says():
    fps, q, r, members = 20.0, 2.0, 0.05, 400
    position, truth = simulate((81, members, 2), fps, q, r, seed=0)
    middle = 40
    kalman = smooth_positions(position, fps, process_noise=q, observation_noise=r)[middle, :, 2:]
    difference = stepwise_velocity(position, fps)[middle]
    # Of a difference, e.g. (a dt / 2)^2 + 2 r^2 / dt^2 of the state at its end; of the smoother,
    # the variance that filterpy tells. The prior of the first velocity is forgotten by the middle.
    _, variances = filterpy_smoother(position[:, 0], fps, q, r)
    expected = {
        "kalman": variances[middle, 2, 2],
        "difference": q**2 / (4 * fps**2) + 2 * (r * fps) ** 2,
    }
    # A mean of n independent squared Gaussian errors has a relative sd of sqrt(2 / n).
    margin = 6 * np.sqrt(2 / (2 * members))
    errors = {
        "kalman": ((kalman - truth[middle]) ** 2).mean(),
        "difference": ((difference - truth[middle]) ** 2).mean(),
    }
    for name, error in errors.items():
        assert abs(error / expected[name] - 1) < margin, name
    # The two margins together leave room to spare between them.
    assert expected["kalman"] * (1 + margin) < expected["difference"] * (1 - margin) / 10
    assert errors["kalman"] < errors["difference"] / 10


# --- the noise ---------------------------------------------------------------------------------


def noise_tolerance(
    length: int, members: int, fps: float, q: float, r: float
) -> tuple[float, float]:
    """Return the standard deviations of the estimates of q^2 and r^2.

    Mean products of a Gaussian series at lags j and k covary by Isserlis' theorem; the second
    differences have the autocovariance that `estimate_noise` states, zero beyond lag 2.
    """
    s, v = (q / fps**2) ** 2, r**2
    lags = [0.5 * s + 6 * v, 0.25 * s - 4 * v, v]
    size = length - 2
    gamma = np.zeros((size, size))
    for lag, value in enumerate(lags):
        gamma += value * (np.eye(size, k=lag) + (np.eye(size, k=-lag) if lag else 0))
    covariance = np.zeros((3, 3))
    for j in range(3):
        for k in range(3):
            a, b = size - j, size - k
            pairs = gamma[:a, :b] * gamma[j:, k:] + gamma[:a, k:] * gamma[j:, :b]
            covariance[j, k] = pairs.sum() / (a * b * members)
    solve = np.linalg.pinv(np.array([[0.5, 6.0], [0.25, -4.0], [0.0, 1.0]]))
    spread = np.sqrt(np.diag(solve @ covariance @ solve.T))
    return spread[0] * fps**4, spread[1]


@pytest.mark.parametrize(("fps", "q", "r"), [(25.0, 30.0, 0.02), (5.0, 1.0, 0.05), (1.0, 3.0, 1.0)])
def test_noise_is_estimated_within_its_standard_error(fps: float, q: float, r: float):
    position, _ = simulate((200, 50, 2), fps, q, r, seed=3)
    spread_q, spread_r = noise_tolerance(200, 100, fps, q, r)
    # The setting says something: six standard errors are well below the value itself.
    assert 6 * spread_q < 0.8 * q**2
    assert 6 * spread_r < 0.8 * r**2
    found_q, found_r = estimate_noise(position, fps)
    assert abs(found_q**2 - q**2) < 6 * spread_q
    assert abs(found_r**2 - r**2) < 6 * spread_r


def test_noise_estimates_do_not_see_gaps():
    position, _ = simulate((400, 20, 2), 10.0, 3.0, 0.05, seed=4)
    whole = estimate_noise(position, 10.0)
    broken = position.copy()
    broken[200:] += 1e6  # a leap of a thousand kilometres ...
    broken[200] = NAN  # ... behind a gap of one frame
    spread_q, spread_r = noise_tolerance(199, 80, 10.0, 3.0, 0.05)
    found = estimate_noise(broken, 10.0)
    assert abs(found[0] ** 2 - whole[0] ** 2) < 6 * spread_q
    assert abs(found[1] ** 2 - whole[1] ** 2) < 6 * spread_r


def test_noise_scales_with_the_units_of_length_and_time():
    position, _ = simulate((100, 10, 2), 10.0, 3.0, 0.05, seed=5)
    q, r = estimate_noise(position, 10.0)
    np.testing.assert_allclose(estimate_noise(100 * position, 10.0), (100 * q, 100 * r), rtol=1e-9)
    np.testing.assert_allclose(estimate_noise(position, 20.0), (4 * q, r), rtol=1e-9)


def test_noise_is_positive_even_where_there_is_none():
    straight = np.arange(50.0)[:, None, None] * [1.0, 2.0]
    q, r = estimate_noise(straight, 10.0)
    assert q == pytest.approx(1e-6 * 1.5 * 100, rel=1e-9)
    assert r == pytest.approx(1e-6 * 1.5, rel=1e-9)
    smoothed = smooth_positions(straight, 10.0)
    np.testing.assert_allclose(smoothed[:, 0, 2:], [[10.0, 20.0]] * 50, rtol=1e-9)
    for nothing in (np.zeros((5, 2, 2)), np.full((5, 2, 2), NAN), np.zeros((1, 2, 2))):
        assert min(estimate_noise(nothing, 10.0)) > 0


def test_lags_that_no_run_reaches_say_nothing():
    # Runs of four frames: second differences at lags 0 and 1 only. Their two equations have one
    # solution, which a made-up zero at lag 2 would spoil.
    fps, q, r = 1.0, 1.0, 0.5
    position, _ = simulate((4, 20_000, 2), fps, q, r, seed=6)
    second = np.diff(position, n=2, axis=0)
    c0, c1 = (second**2).mean(), (second[1:] * second[:-1]).mean()
    s, v = np.linalg.solve([[0.5, 6.0], [0.25, -4.0]], [c0, c1])
    np.testing.assert_allclose(estimate_noise(position, fps), np.sqrt([s, v]), rtol=1e-9)
    assert all(np.isfinite(estimate_noise(position[:3], fps)))


# --- runs --------------------------------------------------------------------------------------


@given(st.lists(st.booleans(), max_size=30))
def test_runs_are_the_true_stretches(present: list[bool]):
    runs = observed_runs(np.array(present, dtype=bool))
    rebuilt = np.zeros(len(present), dtype=bool)
    for start, stop in runs:
        assert start < stop
        assert not rebuilt[start:stop].any()
        rebuilt[start:stop] = True
        assert start == 0 or not present[start - 1]
        assert stop == len(present) or not present[stop]
    assert rebuilt.tolist() == present
    assert runs == sorted(runs)


# --- tracks ------------------------------------------------------------------------------------


@pytest.mark.parametrize("trials", [False, True])
def test_velocities_are_added_in_the_units_and_the_order_of_the_tracks(trials: bool):
    position = np.stack([simulate((20, 3, 2), 10, 1.0, 0.1, seed)[0] for seed in range(2)])
    position[0, 7, 1] = NAN
    tracks = make_tracks(position if trials else position[0], fps=10, unit="cm", frames=range(20))
    before = tracks.copy(deep=True)
    wanted = position if trials else position[:1]
    for method in ("difference", "kalman"):
        found = add_velocity(tracks, method)
        assert found["velocity"].dims == tracks["position"].dims
        assert found["velocity"].attrs == {"units": "cm/s"}
        xr.testing.assert_identical(found.drop_vars("velocity"), tracks)
        states = states_of(found)
        np.testing.assert_array_equal(states[..., :2], wanted)
        if method == "difference":
            expected = stepwise_velocity(wanted, 10.0)
        else:
            expected = smooth_positions(wanted, 10.0)[..., 2:]
        np.testing.assert_array_equal(states[..., 2:], expected)
        again = add_velocity(found.assign(velocity=found["velocity"] * 0), method)
        xr.testing.assert_identical(again, found)
    xr.testing.assert_identical(tracks, before)


def test_the_given_noises_are_used():
    position, _ = simulate((30, 3, 2), 10, 1.0, 0.1, seed=0)
    tracks = make_tracks(position, fps=10)
    given_both = add_velocity(tracks, "kalman", process_noise=2.0, observation_noise=0.3)
    expected = smooth_positions(position, 10.0, process_noise=2.0, observation_noise=0.3)
    np.testing.assert_array_equal(states_of(given_both)[0, ..., 2:], expected[..., 2:])
    q, r = estimate_noise(position, 10.0)
    for mine, both in (
        ({"process_noise": 2.0}, {"process_noise": 2.0, "observation_noise": r}),
        ({"observation_noise": 0.3}, {"process_noise": q, "observation_noise": 0.3}),
        ({}, {"process_noise": q, "observation_noise": r}),
    ):
        np.testing.assert_array_equal(
            smooth_positions(position, 10.0, **mine), smooth_positions(position, 10.0, **both)
        )


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, NAN])
@pytest.mark.parametrize("name", ["process_noise", "observation_noise"])
def test_noises_that_are_none_are_refused(name: str, value: float):
    tracks = make_tracks(np.zeros((3, 1, 2)), fps=1)
    with pytest.raises(InputError) as caught:
        add_velocity(tracks, "kalman", **{name: value})
    assert str(caught.value) == f"{name}: it must be a positive number, not {value}."


def test_an_unknown_method_is_refused():
    tracks = make_tracks(np.zeros((3, 1, 2)), fps=1)
    with pytest.raises(InputError) as caught:
        add_velocity(tracks, "spline")
    assert str(caught.value) == "method: 'spline' is unknown; choose one of difference, kalman."
