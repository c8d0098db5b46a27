"""States of a group by their limits, and how long they last."""

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.metrics.states import STATES, group_states, mean_state_duration

SWARM, POLARIZED, MILLING, TRANSITION = range(4)


def test_states_by_the_limits_of_the_paper():
    polarization = [0.1, 0.7, 0.3, 0.5, 0.7, np.nan]
    rotation = [0.3, 0.2, 0.9, 0.1, 0.7, 0.1]
    found = group_states(polarization, rotation)
    assert STATES == ("swarm", "polarized", "milling", "transition")
    np.testing.assert_array_equal(found, [SWARM, POLARIZED, MILLING, TRANSITION, TRANSITION, -1])


def test_a_way_through_transition_and_back_is_no_change():
    states = [SWARM, TRANSITION, SWARM, -1, SWARM, SWARM]
    # Five known frames at 10 fps, one stay.
    assert mean_state_duration(states, 10.0) == pytest.approx(0.5)


def test_changes_are_counted_in_each_run_by_itself():
    states = [[SWARM, TRANSITION, POLARIZED, POLARIZED], [MILLING, MILLING, MILLING, SWARM]]
    # Eight frames, two stays in each run.
    assert mean_state_duration(states, 2.0) == pytest.approx(1.0)


def test_a_run_in_transition_throughout_is_one_stay():
    assert mean_state_duration([TRANSITION] * 6, 2.0) == pytest.approx(3.0)
    assert np.isnan(mean_state_duration([-1, -1], 2.0))


def test_wrong_input_is_refused():
    with pytest.raises(InputError, match="fps"):
        mean_state_duration([0, 1], 0.0)
    with pytest.raises(InputError, match="rotation"):
        group_states([0.1], [0.1, 0.2])
