import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmssm.errors import InputError
from swarmssm.tracks import Array, stepwise_velocity
from swarmssm.tracks.scaling import SCALERS, Scaler, fit_scaler

NAN = np.nan


def random_states(seed: int = 0, space: int = 2, offset: float = 0.0) -> Array:
    """States (trial, time, individual, state) of a random walk with gaps."""
    generator = np.random.default_rng(seed)
    position = offset + np.cumsum(generator.normal(size=(3, 20, 4, space)), axis=1)
    position[generator.random((3, 20, 4)) < 0.1] = NAN
    velocity = stepwise_velocity(position, generator.uniform(0.1, 100))
    return np.concatenate([position, velocity], axis=-1)


def test_min_max_worked_by_hand():
    states = np.array([[[0.0, -4.0, NAN, NAN], [5.0, 0.0, 1.0, 0.5], [10.0, 4.0, 3.0, -0.5]]])
    scaler = fit_scaler(states, "minmax")
    assert scaler == Scaler("minmax", (0.0, -4.0, 1.0, -0.5), (10.0, 8.0, 2.0, 1.0))
    np.testing.assert_array_equal(
        scaler.transform(states),
        [[[0.0, 0.0, NAN, NAN], [0.5, 0.5, 0.0, 1.0], [1.0, 1.0, 1.0, 0.0]]],
    )
    # What lies outside the training part's range lies outside [0, 1].
    np.testing.assert_array_equal(
        scaler.transform(np.array([20.0, 0, 0, 0])), [2.0, 0.5, -0.5, 0.5]
    )


def test_isotropic_worked_by_hand():
    # Places about (2, 3): deviations (-2, -1), (2, 1), mean square over both axes (4 + 1) / 2.
    states = np.array([[0.0, 2.0, NAN, NAN], [4.0, 4.0, 3.0, 4.0]])
    scaler = fit_scaler(states, "isotropic")
    length, speed = np.sqrt(2.5), np.sqrt(12.5)
    assert scaler.offset == (2.0, 3.0, 0.0, 0.0)
    np.testing.assert_allclose(scaler.scale, [length, length, speed, speed], rtol=1e-15)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.sampled_from([0.0, -1e4]))
def test_every_feature_of_the_training_part_spans_zero_to_one(seed: int, space: int, offset: float):
    states = random_states(seed, space, offset)
    scaled = fit_scaler(states, "minmax").transform(states)
    # Also in the first frames and after gaps, where the place is known and the velocity is not.
    assert np.nanmin(scaled, axis=(0, 1, 2)).tolist() == [0.0] * (2 * space)
    assert np.nanmax(scaled, axis=(0, 1, 2)).tolist() == [1.0] * (2 * space)
    # (3.49), feature by feature.
    for k in range(2 * space):
        x = states[..., k]
        expected = (x - np.nanmin(x)) / (np.nanmax(x) - np.nanmin(x))
        np.testing.assert_array_equal(scaled[..., k], expected)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from(SCALERS), st.sampled_from([2, 3]))
def test_scaling_is_undone_exactly_and_nan_stays(seed: int, kind: str, space: int):
    states = random_states(seed, space)
    scaler = fit_scaler(states, kind)
    scaled = scaler.transform(states)
    np.testing.assert_array_equal(np.isnan(scaled), np.isnan(states))
    # Either way costs a few roundings of numbers no larger than the range of the features.
    largest = np.nanmax(np.abs(states), axis=(0, 1, 2))
    error = np.abs(scaler.inverse(scaled) - states) / largest
    assert np.nanmax(error) < 1e-12
    other = np.random.default_rng(seed).uniform(-2, 2, (5, 2 * space))
    np.testing.assert_allclose(scaler.transform(scaler.inverse(other)), other, rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", SCALERS)
def test_tensors_are_scaled_as_arrays_are(kind: str):
    states = random_states()
    scaler = fit_scaler(states, kind)
    scaled = scaler.transform(states)
    double = torch.as_tensor(states)
    np.testing.assert_array_equal(scaler.transform_tensor(double).numpy(), scaled)
    np.testing.assert_array_equal(
        scaler.inverse_tensor(torch.as_tensor(scaled)).numpy(), scaler.inverse(scaled)
    )
    single = double.float()
    assert scaler.transform_tensor(single).dtype == torch.float32
    assert scaler.inverse_tensor(single).dtype == torch.float32
    np.testing.assert_allclose(scaler.transform_tensor(single).numpy(), scaled, rtol=0, atol=1e-5)


def test_gradients_pass_through():
    scaler = Scaler("minmax", (0.0, 1.0, 2.0, 3.0), (1.0, 2.0, 4.0, 8.0))
    states = torch.zeros(3, 4, requires_grad=True)
    scaler.transform_tensor(states).sum().backward()
    np.testing.assert_array_equal(states.grad.numpy(), [[1.0, 0.5, 0.25, 0.125]] * 3)


def turned(states: Array, seed: int) -> Array:
    """Turn places and velocities by the same random rotation."""
    space = states.shape[-1] // 2
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(space, space)))
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    return np.concatenate([states[..., :space] @ turn.T, states[..., space:] @ turn.T], axis=-1)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_the_isotropic_scaler_commutes_with_rotation_and_translation(seed: int, space: int):
    states = random_states(seed, space)
    shift = np.concatenate([np.random.default_rng(seed).normal(size=space), np.zeros(space)])
    moved = turned(states, seed) + shift
    scaler, moved_scaler = fit_scaler(states, "isotropic"), fit_scaler(moved, "isotropic")
    np.testing.assert_allclose(
        moved_scaler.transform(moved), turned(scaler.transform(states), seed), rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(moved_scaler.scale, scaler.scale, rtol=1e-12)
    # Scaled velocities keep their directions.
    velocity, scaled = states[..., space:], scaler.transform(states)[..., space:]
    np.testing.assert_allclose(scaled * scaler.scale[-1], velocity, rtol=1e-12)


def test_min_max_does_not_commute_with_rotation():
    states = random_states() * [1.0, 10.0, 1.0, 10.0]
    moved = turned(states, 1)
    one = fit_scaler(moved, "minmax").transform(moved)
    other = turned(fit_scaler(states, "minmax").transform(states), 1)
    assert np.nanmax(np.abs(np.diff(one - other, axis=1))) > 0.1


def test_none_leaves_everything_as_it_is():
    states = random_states(space=3)
    scaler = fit_scaler(states, "none")
    assert scaler == Scaler("none", (0.0,) * 6, (1.0,) * 6)
    np.testing.assert_array_equal(scaler.transform(states), states)


def test_isotropic_takes_what_stands_still_along_one_axis():
    states = random_states()
    states[..., [0, 2]] = [7.0, 0.0]
    scaler = fit_scaler(states, "isotropic")
    assert np.nanmax(np.abs(scaler.transform(states)[..., [0, 2]])) == 0
    assert min(scaler.scale) > 0


def test_other_features_than_states_can_be_scaled_by_their_ranges():
    scaler = fit_scaler(np.array([[1.0, 10.0], [3.0, 20.0]]), "minmax")
    assert scaler == Scaler("minmax", (1.0, 10.0), (2.0, 10.0))
    with pytest.raises(InputError) as caught:
        fit_scaler(np.array([[1.0, 10.0], [3.0, 20.0]]), "isotropic")
    assert str(caught.value) == (
        "states: an isotropic scaler needs positions and velocities, 4 features or 6, and there "
        "are 2."
    )


def constant(index: int, value: float, wobble: float = 0.0, space: int = 2) -> Array:
    states = random_states(space=space)
    generator = np.random.default_rng(0)
    states[..., index] = value + wobble * generator.uniform(size=states.shape[:-1])
    return states


NO_VELOCITY = np.concatenate([np.zeros((5, 2)), np.full((5, 2), NAN)], -1)


@pytest.mark.parametrize(
    ("states", "kind", "sentence"),
    [
        (
            random_states(),
            "zscore",
            "scaler: 'zscore' is unknown; choose one of minmax, isotropic, none.",
        ),
        *(
            (
                NO_VELOCITY,
                kind,
                "tracks: no individual is seen in two consecutive frames of the training part.",
            )
            for kind in SCALERS
        ),
        (
            constant(1, 3.0),
            "minmax",
            "tracks: nothing moves in the training part along position y; there is no range to "
            "scale by. Choose the scaler isotropic or none.",
        ),
        (constant(2, 0.0), "minmax", "along velocity x; there is no range"),
        (constant(5, 0.0, space=3), "minmax", "along velocity z; there is no range"),
        # Rounding alone is no range.
        (constant(0, 1e6, wobble=1e-9), "minmax", "along position x; there is no range"),
        (
            np.ones((5, 4)),
            "isotropic",
            "along position x; there is no range to scale by. Choose the scaler none.",
        ),
        (
            np.concatenate([random_states()[..., :2], np.zeros((3, 20, 4, 2))], -1),
            "isotropic",
            "along velocity x; there is no range",
        ),
        (np.ones((5, 3)) * [[1], [2], [3], [4], [5]] * [1, 0, 1], "minmax", "along feature 1;"),
    ],
)
def test_what_cannot_be_scaled_is_refused(states: Array, kind: str, sentence: str):
    with pytest.raises(InputError) as caught:
        fit_scaler(states, kind)
    assert sentence in str(caught.value)


def test_a_scaler_is_plain_data():
    scaler = fit_scaler(random_states(), "minmax")
    values: dict[str, Any] = dataclasses.asdict(scaler)
    assert Scaler(**values) == scaler
    assert all(type(number) is float for number in (*scaler.offset, *scaler.scale))
    with pytest.raises(dataclasses.FrozenInstanceError):
        scaler.kind = "none"
