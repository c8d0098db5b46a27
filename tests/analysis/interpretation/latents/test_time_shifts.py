"""Shifts in time: what they move, how many there are, and what they say of chance."""

import numpy as np
import pytest

from swarmssm.analysis.interpretation.latents.time_shifts import Shifts, filled, p_values, shifts_of
from swarmssm.errors import InputError


def test_a_shift_turns_the_whole_swarm_around():
    values = np.arange(12.0).reshape(1, 6, 2, 1)
    shifts = Shifts(np.array([[0]]), np.array([[2]]), np.array([6]))
    moved = shifts.moved(values, 0)
    assert moved[0, :, 0, 0].tolist() == [4, 6, 8, 10, 0, 2]
    assert moved[0, :, 1, 0].tolist() == [5, 7, 9, 11, 1, 3]


def test_trials_are_exchanged_and_turned_within_their_own_length():
    values = np.full((2, 4, 1, 1), np.nan)
    values[0, :3, 0, 0] = [1, 2, 3]
    values[1, :, 0, 0] = [10, 20, 30, 40]
    shifts = Shifts(np.array([[1, 0]]), np.array([[3, 1]]), np.array([3, 4]))
    moved = shifts.moved(values, 0)[..., 0, 0]
    assert moved[0].tolist() == [40, 10, 20, 30]
    assert moved[1].tolist() == [2, 3, 1, 2]


def test_shifts_of_one_trial_are_different_and_never_small():
    shifts = shifts_of(np.array([100]), 50, least=10, seed=0)
    offsets = shifts.offset[:, 0]
    assert len(set(offsets.tolist())) == len(shifts) == 50
    assert offsets.min() >= 10
    assert offsets.max() <= 90
    assert shifts.least_p == pytest.approx(1 / 51)


def test_a_short_trial_has_only_so_many_shifts():
    shifts = shifts_of(np.array([30]), 199, least=10, seed=0)
    assert sorted(shifts.offset[:, 0].tolist()) == list(range(10, 21))
    assert shifts.least_p == pytest.approx(1 / 12)


def test_trials_that_keep_their_place_are_shifted_far():
    shifts = shifts_of(np.array([40, 0, 60]), 300, least=15, seed=1)
    assert (shifts.source[:, 1] == 1).all()
    assert (np.sort(shifts.source, 1) == [0, 1, 2]).all()
    own = shifts.source == np.arange(3)
    for trial, length in ((0, 40), (2, 60)):
        offsets = shifts.offset[own[:, trial], trial]
        assert len(offsets) > 50
        assert offsets.min() >= 15
        assert offsets.max() <= length - 15


def test_a_trial_too_short_to_be_shifted_is_refused():
    with pytest.raises(InputError, match="only 20 frames"):
        shifts_of(np.array([100, 20]), 9, least=10)


def test_p_values_by_hand():
    null = np.array([[0.1, 0.5], [0.2, 0.5], [0.3, 0.5]])
    found = np.array([0.25, 0.6])
    assert p_values(found, null).tolist() == [2 / 4, 1 / 4]
    assert p_values(np.array([0.3, 0.5]), null).tolist() == [2 / 4, 4 / 4]
    assert np.isnan(p_values(np.array([np.nan, 0.0]), null)).tolist() == [True, False]


def test_gaps_take_the_value_before():
    nan = np.nan
    values = np.array([[nan, 1, nan, 2, nan], [7, nan, nan, 8, 9], [nan] * 5]).T[None, ..., None]
    full = filled(values)[0, ..., 0].T
    assert full[0].tolist() == [1, 1, 1, 2, 2]
    assert full[1].tolist() == [7, 7, 7, 8, 9]
    # Who is never seen takes the mean of the others.
    assert full[2].tolist() == [4, 4, 4, 5, 5.5]
