"""Cross-validated probes: equal to scikit-learn's, and not fooled by slow recordings."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.metrics import r2_score
from sklearn.model_selection import KFold, LeaveOneGroupOut, cross_val_predict

from swarmssm.analysis.interpretation.latents.block_folds import Cells, block_folds, decorrelation
from swarmssm.analysis.interpretation.latents.probes import PENALTIES, RidgeProbe, curved
from swarmssm.errors import InputError


def recording(trials=4, frames=30, individuals=2):
    """Return folds of a fully known recording, each sample's place, and each sample's trial."""
    known = np.ones((trials, frames), dtype=bool)
    place = np.repeat(np.arange(trials * frames), individuals)
    return block_folds(known, folds=max(3, trials)), place, place // frames


def random_walk(generator, length):
    return np.cumsum(generator.standard_normal(length))


def test_whole_trials_are_left_out_where_there_are_three():
    known = np.ones((5, 10), dtype=bool)
    known[2, 4:] = False
    folds = block_folds(known, folds=3)
    assert folds.by == "trial"
    assert (folds.test.sum(0) == known).all()
    for train, test in zip(folds.train, folds.test, strict=True):
        assert not (train.any(1) & test.any(1)).any()
        assert ((train | test) == known).all()


def test_blocks_of_time_keep_their_distance():
    known = np.ones((2, 100), dtype=bool)
    folds = block_folds(known, folds=5, gap=7)
    assert (folds.by, folds.gap) == ("time", 7)
    assert (folds.test.sum(0) == 1).all()
    for train, test in zip(folds.train, folds.test, strict=True):
        for trial in range(2):
            apart = np.abs(np.flatnonzero(train[trial])[:, None] - np.flatnonzero(test[trial]))
            assert apart.min() == 8
            # 20 frames are tested, and each side that is there has a gap.
            assert train[trial].sum() in (100 - 20 - 7, 100 - 20 - 14)


def test_too_few_folds_or_frames_are_refused():
    with pytest.raises(InputError, match="at least 3"):
        block_folds(np.ones((1, 100), dtype=bool), folds=2)
    with pytest.raises(InputError, match="too few"):
        block_folds(np.ones((1, 2), dtype=bool), folds=3)


def test_memory_of_an_autoregression():
    generator = np.random.default_rng(0)
    values = np.zeros((1, 20_000, 1, 2))
    for t in range(1, values.shape[1]):
        values[0, t] = 0.8 * values[0, t - 1] + generator.standard_normal((1, 2))
    values[0, ::7] = np.nan
    # 0.8 ** 4 = 0.41 is above 1 / e, 0.8 ** 5 = 0.33 is below.
    assert decorrelation(values) == 5


def test_equal_to_cross_val_predict():
    folds, place, trial = recording()
    generator = np.random.default_rng(1)
    features = generator.standard_normal((len(place), 6)) * np.array([1, 2, 0.1, 1, 1, 1])
    targets = features[:, :4] @ generator.standard_normal((4, 4)) + 3.0
    targets += generator.standard_normal(targets.shape)
    penalty = 0.03
    # Each training part has three of four trials, and scikit-learn's penalty is not per sample.
    ridge = Ridge(alpha=penalty * 0.75 * len(place))
    predicted = cross_val_predict(ridge, features, targets, groups=trial, cv=LeaveOneGroupOut())
    probe = RidgeProbe(features, Cells.of(place, folds), penalties=(penalty,))
    each, vector = probe.r2(targets.reshape(-1, 2, 2))
    expected = r2_score(targets, predicted, multioutput="raw_values")
    np.testing.assert_allclose(each.reshape(-1), expected, rtol=1e-10)
    for k in range(2):
        part = slice(2 * k, 2 * k + 2)
        error = np.square(targets - predicted)[:, part].sum()
        total = np.square(targets - targets.mean(0))[:, part].sum()
        assert vector[0, k] == pytest.approx(1 - error / total, rel=1e-10)


def test_penalties_are_chosen_without_the_tested_fold():
    folds, place, trial = recording()
    generator = np.random.default_rng(2)
    features = generator.standard_normal((len(place), 40))
    targets = features[:, :1] + 2.0 * generator.standard_normal((len(place), 2))
    predicted = np.empty_like(targets)
    for left_out in range(4):
        train = trial != left_out
        errors = np.zeros(len(PENALTIES))
        for inner in set(range(4)) - {left_out}:
            fitted, told = train & (trial != inner), train & (trial == inner)
            for index, penalty in enumerate(PENALTIES):
                ridge = Ridge(alpha=penalty * fitted.sum()).fit(features[fitted], targets[fitted])
                errors[index] += np.square(targets[told] - ridge.predict(features[told])).sum()
        ridge = Ridge(alpha=PENALTIES[errors.argmin()] * train.sum())
        predicted[~train] = ridge.fit(features[train], targets[train]).predict(features[~train])
    probe = RidgeProbe(features, Cells.of(place, folds))
    each, _ = probe.r2(targets[:, None])
    expected = r2_score(targets, predicted, multioutput="raw_values")
    np.testing.assert_allclose(each[0, 0], expected, rtol=1e-8, atol=1e-10)


def test_many_targets_and_many_groups_are_each_as_by_itself():
    folds, place, _ = recording()
    generator = np.random.default_rng(3)
    features = generator.standard_normal((3, len(place), 2))
    targets = generator.standard_normal((len(place), 5, 2)) + features[0][:, None]
    cells = Cells.of(place, folds)
    each, vector = RidgeProbe(features, cells).r2(targets)
    for group in range(3):
        for k in range(5):
            one, other = RidgeProbe(features[group], cells).r2(targets[:, k : k + 1])
            np.testing.assert_allclose(each[group, k], one[0, 0], rtol=1e-9)
            assert vector[group, k] == pytest.approx(other[0, 0], rel=1e-9)


def test_what_does_not_vary():
    folds, place, _ = recording()
    generator = np.random.default_rng(4)
    features = np.zeros((2, len(place), 1))
    features[1, :, 0] = generator.standard_normal(len(place))
    targets = np.stack([np.full(len(place), 2.5), features[1, :, 0]], -1)[:, :, None]
    each, vector = RidgeProbe(features, Cells.of(place, folds)).r2(targets)
    assert np.isnan(each[:, 0]).all()
    assert np.isnan(vector[:, 0]).all()
    # A constant feature tells the mean of the training part, which is not quite that of all.
    assert -0.2 < vector[0, 1] <= 0.0
    assert vector[1, 1] == pytest.approx(1.0, abs=1e-6)


def test_slow_noise_fools_shuffled_folds_and_not_blocks():
    generator = np.random.default_rng(5)
    scores = []
    for _ in range(10):
        features = np.stack([random_walk(generator, 600) for _ in range(3)], -1)
        target = random_walk(generator, 600)
        bumps = curved(features, 100)
        shuffled = KFold(5, shuffle=True, random_state=0)
        fooled = cross_val_predict(Ridge(alpha=1e-2), bumps, target, cv=shuffled)
        known = np.ones((1, 600), dtype=bool)
        cells = Cells.of(
            np.arange(600), block_folds(known, gap=decorrelation(target[None, :, None, None]) // 4)
        )
        blocked = RidgeProbe(bumps, cells).r2(target[:, None, None])[1][0, 0]
        scores.append((r2_score(target, fooled), blocked))
    fooled, blocked = np.array(scores).T
    # The walks have nothing to do with each other.
    assert np.median(fooled) > 0.8
    assert np.median(blocked) < 0.05


def test_a_kernel_probe_finds_what_a_linear_one_cannot():
    folds, place, _ = recording(frames=100)
    generator = np.random.default_rng(6)
    features = generator.standard_normal((len(place), 2))
    target = (features[:, :1] ** 2)[:, None]
    cells = Cells.of(place, folds)
    assert RidgeProbe(features, cells).r2(target)[1][0, 0] < 0.05
    assert RidgeProbe(curved(features, 60), cells).r2(target)[1][0, 0] > 0.95


def test_canonical_correlations():
    folds, place, _ = recording(frames=500)
    generator = np.random.default_rng(7)
    n = len(place)
    features = generator.standard_normal((n, 4))
    noise = generator.standard_normal((n, 2))
    # Along one direction the correlation is 0.8, along the other there is none.
    shared = features @ np.array([0.5, 0.5, 0.5, 0.5])
    targets = np.stack([0.8 * shared + 0.6 * noise[:, 0], noise[:, 1]], -1)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    probe = RidgeProbe(features, Cells.of(place, folds), penalties=(1e-2,))
    found = probe.canonical(targets @ turn)[0]
    assert found[0] == pytest.approx(0.8, abs=6 * 0.36 / np.sqrt(n))
    assert abs(found[1]) < 6 / np.sqrt(n)


def test_single_directions_are_straight_lines():
    folds, place, trial = recording()
    generator = np.random.default_rng(8)
    features = generator.standard_normal((len(place), 3))
    targets = features @ generator.standard_normal((3, 2)) + generator.standard_normal(
        (len(place), 2)
    )
    directions = generator.standard_normal((4, 2, 3))
    probe = RidgeProbe(features, Cells.of(place, folds), penalties=(1e-3,))
    tested = [int(np.flatnonzero(test.any(1))[0]) for test in folds.test]
    expected = np.empty((2, 2))
    for axis in range(2):
        predicted = np.empty_like(targets)
        for fold, left_out in enumerate(tested):
            score = features @ directions[fold, axis][:, None]
            train = trial != left_out
            line = LinearRegression().fit(score[train], targets[train])
            predicted[~train] = line.predict(score[~train])
        expected[axis] = r2_score(targets, predicted, multioutput="raw_values")
    np.testing.assert_allclose(probe.axis_r2(targets, directions), expected, rtol=1e-9)


def test_weights_are_those_of_ridge():
    folds, place, _ = recording()
    generator = np.random.default_rng(9)
    features = generator.standard_normal((len(place), 3)) + 5.0
    targets = generator.standard_normal((len(place), 2))
    probe = RidgeProbe(features, Cells.of(place, folds), penalties=(0.1,))
    expected = Ridge(alpha=0.1 * len(place)).fit(features, targets).coef_
    np.testing.assert_allclose(probe.coefficients(targets)[0], expected, rtol=1e-9)
