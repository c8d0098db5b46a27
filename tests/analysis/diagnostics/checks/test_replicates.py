"""Replicates start where the recording was, and are seen as it was seen."""

import numpy as np
import pytest
import torch

from swarmssm.analysis.diagnostics.checks.replicates import replicates, runs_of
from swarmssm.analysis.posterior.subject import subject_of
from swarmssm.errors import InputError
from swarmssm.inference.prediction import Trajectory
from swarmssm.jobs import Progress

#: Of the flock's tracking.
NOISE = 0.03
NAN = np.nan


def begun(fit, tracks, steps=None):
    subject = subject_of(fit, tracks)
    predictor = subject.fit.predictor()
    return subject, predictor, runs_of(subject, predictor, steps)


def hidden(tracks, place):
    """Return tracks of which some positions ``[trial, time, space, individual]`` are not seen."""
    position = tracks["position"].copy(deep=True)
    position.values[place] = NAN
    return tracks.assign(position=position)


def test_one_run_from_a_filtered_start_to_the_end(flock):
    _, _, runs = begun(*flock)
    # A quarter of 39 steps are history.
    assert (runs.trials.tolist(), runs.rows.tolist(), runs.steps) == ([0], [9], 30)
    order = ("trial", "time", "individual", "space")
    expected = flock[1]["position"].transpose(*order).to_numpy()[:, 9:]
    np.testing.assert_array_equal(runs.seen, expected)
    assert runs.left_out == 0.0


def test_runs_follow_each_other_and_the_last_may_be_short(flock):
    _, _, runs = begun(*flock, steps=12)
    assert runs.rows.tolist() == [9, 21, 33]
    assert np.isnan(runs.seen[2, 7:]).all()
    assert np.isfinite(runs.seen[2, :7]).all()
    # Less than half a run is left: it is not begun.
    assert begun(*flock, steps=25)[2].rows.tolist() == [9]


def test_gaps_are_gaps_in_replicates_too(flock):
    fit, tracks = flock
    subject, predictor, runs = begun(fit, hidden(tracks, np.s_[0, 20:25, :, 2]))
    found = list(replicates(subject, predictor, runs, 3, 0))
    for positions in found:
        np.testing.assert_array_equal(np.isnan(positions), np.isnan(runs.seen))
        np.testing.assert_array_equal(positions[:, 0], runs.seen[:, 0])
    assert not np.allclose(found[0][:, 5, 0], found[1][:, 5, 0])


def test_who_comes_later_is_left_out(flock):
    fit, tracks = flock
    _, _, runs = begun(fit, hidden(tracks, np.s_[0, :20, :, 4]))
    assert runs.present.tolist() == [[True, True, True, True, False]]
    assert np.isnan(runs.seen[:, :, 4]).all()
    # Frames 10 to 39: 120 sightings of four, and 20 of the one that came.
    assert runs.left_out == pytest.approx(20 / 140)


def test_who_is_out_of_sight_at_the_start_is_carried_on(flock):
    fit, tracks = flock
    _, _, runs = begun(fit, hidden(tracks, np.s_[0, 8:11, :, 4]))
    assert runs.present.all()
    assert np.isnan(runs.seen[0, :2, 4]).all()
    assert np.isfinite(runs.seen[0, 2:, 4]).all()


def still(beginning, steps):
    """Return a run in which everybody is at the origin."""
    shape = (*beginning.states.shape[:-2], steps, *beginning.states.shape[-2:])
    nobody = torch.zeros(*shape[:-1], shape[-2])
    return Trajectory(torch.zeros(shape), nobody, nobody.bool())


def test_the_noise_of_tracking_is_added(flock, monkeypatch):
    subject, predictor, runs = begun(*flock)
    monkeypatch.setattr(
        type(predictor), "run", lambda self, beginning, steps, *, sample: still(beginning, steps)
    )
    drawn = np.stack(list(replicates(subject, predictor, runs, 40, 0)))[:, :, 1:]
    number = drawn.size
    assert drawn.std() == pytest.approx(NOISE, abs=6 * NOISE / np.sqrt(2 * number))
    assert abs(drawn.mean()) < 6 * NOISE / np.sqrt(number)


@pytest.mark.parametrize("value", [np.inf, NAN, 1e12])
def test_who_flies_off_is_told_of(flock, monkeypatch, value):
    subject, predictor, runs = begun(*flock)

    def run(self, beginning, steps, *, sample):
        path = still(beginning, steps)
        path.states[1, 0, -1, 3] = value
        return path

    monkeypatch.setattr(type(predictor), "run", run)
    found = list(replicates(subject, predictor, runs, 3, 0))
    assert [positions is None for positions in found] == [False, True, False]


def test_the_same_seed_gives_the_same_and_progress_is_told(flock):
    subject, predictor, runs = begun(*flock)
    told = []
    first = list(replicates(subject, predictor, runs, 2, 5, told.append))
    again = list(replicates(subject, predictor, runs, 2, 5))
    np.testing.assert_array_equal(first, again)
    assert told == [Progress(2, 2)]


def test_runs_that_do_not_fit_are_refused(flock):
    with pytest.raises(InputError, match="room for 30 steps, and runs of 31"):
        begun(*flock, steps=31)


def test_copies_share_their_parameters_alone(flock, monkeypatch):
    """With a name that has a prior, so that draws run one by one, four at once."""
    subject, predictor, runs = begun(*flock)
    monkeypatch.setattr(
        "swarmssm.analysis.diagnostics.checks.replicates.priors_of", lambda model: ["noise"]
    )
    asked = []
    begin = type(predictor).begin

    def watched(self, prepared, trials, rows, draws, *, carry=False):
        asked.append((trials.tolist(), rows.tolist(), draws))
        return begin(self, prepared, trials, rows, draws, carry=carry)

    monkeypatch.setattr(type(predictor), "begin", watched)
    found = list(replicates(subject, predictor, runs, 6, 0, copies=4))
    assert asked == [([0] * 4, [9] * 4, 2)]
    assert len(found) == 6
    assert len({positions[0, 1, 0, 0] for positions in found}) == 6
