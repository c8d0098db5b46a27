"""How well one quantity can be read from another: ridge regressions, cross-validated in blocks.

All regressions of a design are made of the same few sums - of x, of x x', of x y' over each block
of frames - so that thousands of targets, such as those of a permutation test, cost a product of
matrices.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.kernel_approximation import Nystroem

from swarmssm.analysis.interpretation.latents.block_folds import Cells
from swarmssm.tracks import Array

__all__ = ["PENALTIES", "RidgeProbe", "curved"]

Mask = npt.NDArray[np.bool_]
_Trained = tuple[float, Array, Array, Array]
#: Penalties that are tried, per sample, for features of unit variance.
PENALTIES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
#: A target whose variance is below this part of its mean square is constant.
CONSTANT = 1e-18


def curved(features: Array, landmarks: int, seed: int = 0) -> Array:
    """Return features in which a linear probe is a kernel ridge regression.

    The kernel is the sum of a linear one and a Gaussian one as wide as the median distance, the
    latter by Nystroem's approximation: of bounded size, whatever the number of samples. Landmarks
    are chosen of all samples, tested ones too; of the targets they know nothing.

    Parameters
    ----------
    features
        ``(sample, feature)``.
    landmarks
        At most how many.
    seed
        Of their choice.

    Returns
    -------
    ``(sample, feature + landmark)``; a kernel ridge regression neither scales nor weighs them.
    """
    spread = features.std(0)
    scaled = (features - features.mean(0)) / np.where(spread > 0, spread, 1.0)
    generator = np.random.default_rng(seed)
    some = scaled[generator.permutation(len(scaled))[:500]]
    squares = np.square(some[:, None] - some[None]).sum(-1)
    typical = float(np.median(squares[squares > 0])) if (squares > 0).any() else 1.0
    landmarks = min(landmarks, len(np.unique(some, axis=0)))
    bumps = Nystroem(gamma=1.0 / typical, n_components=landmarks, random_state=seed)
    return np.concatenate(
        [scaled / np.sqrt(scaled.shape[1]), bumps.fit_transform(scaled)], axis=1
    ).astype(np.float64)


@dataclass(frozen=True)
class _Fold:
    """Regression on a training part, ready for any target, in the eigenbasis of the features."""

    train: Mask
    test: Mask
    count: float
    mean: Array
    basis: Array
    eigenvalues: Array
    tested: Array
    shift: Array


class RidgeProbe:
    """Ridge regressions of any targets on given features, cross-validated in blocks.

    The penalty of each target is chosen within the training part of each fold, by leaving out one
    of the other folds at a time.

    Parameters
    ----------
    features
        ``(sample, feature)``, or ``(group, sample, feature)`` for as many separate regressions.
        They are centred in each training part, and keep their size: to scale them there
        as well would blow up one that hardly varies in training, such as a push of walls.
    cells
        Which samples train and test.
    penalties
        Those to choose from, per sample.
    """

    def __init__(
        self,
        features: Array,
        cells: Cells,
        *,
        penalties: tuple[float, ...] = PENALTIES,
    ) -> None:
        grouped = features if features.ndim == 3 else features[None]
        self.penalties = penalties
        self.features = (grouped - grouped.mean(1, keepdims=True))[:, cells.order]
        self.cells, self.count = cells, cells.count
        chosen = [self.features[:, part] for part in cells.slices]
        self.sum = np.stack([part.sum(1) for part in chosen])
        self.square = np.stack([part.swapaxes(1, 2) @ part for part in chosen])
        self.trained: dict[bytes, _Trained] = {}
        self.folds, self.inner = [], []
        for fold, (train, test) in enumerate(zip(cells.train, cells.test, strict=True)):
            self.folds.append(self._prepare(train, test))
            others = [
                self._prepare(train & cells.train[other], cells.test[other] & train)
                for other in range(len(cells.train))
                if other != fold and len(penalties) > 1
            ]
            self.inner.append([other for other in others if other is not None])
        self.trained.clear()

    def r2(self, targets: Array) -> tuple[Array, Array]:
        """Return the share of variance that is predicted of frames that were left out.

        Parameters
        ----------
        targets
            ``(sample, target, component)``: components of a vector share a penalty.

        Returns
        -------
        ``(group, target, component)`` of each component, and ``(group, target)`` of the vectors;
        1 for a perfect prediction, 0 for one as good as the mean, NaN for a constant target.
        """
        sums = self._target_sums(targets)
        error = np.zeros((len(self.features), *targets.shape[1:]))
        for fold, inner in zip(self.folds, self.inner, strict=True):
            if fold is not None:
                error += self._error(fold, inner, sums)
        centred = targets - targets.mean(0)
        total = np.square(centred).sum(0)
        constant = total <= CONSTANT * np.square(targets).sum(0)
        with np.errstate(invalid="ignore", divide="ignore"):
            each = np.where(constant, np.nan, 1.0 - error / total)
            whole = 1.0 - error.sum(-1) / total.sum(-1)
        return each, np.where(constant.all(-1), np.nan, whole)

    def coefficients(self, targets: Array, train: Mask | None = None) -> Array:
        """Return regression weights by the raw features, penalised by the middle penalty.

        Parameters
        ----------
        targets
            ``(sample, target)``.
        train
            ``(cell,)`` of bool: cells to fit on; absent, all.

        Returns
        -------
        ``(group, target, feature)``.
        """
        everything = np.ones(len(self.count), dtype=bool) if train is None else train
        fold = self._prepare(everything, everything)
        assert fold is not None
        sums = self._target_sums(targets[..., None])
        slope = self._slope(fold, sums)
        penalty = self.penalties[len(self.penalties) // 2]
        weight: Array = fold.basis @ (slope / (fold.eigenvalues[..., None] + penalty))
        return weight.swapaxes(-1, -2)

    def axis_r2(self, targets: Array, directions: Array) -> Array:
        """Return how well single directions in feature space predict each target.

        Parameters
        ----------
        targets
            ``(sample, target)``.
        directions
            ``(fold, axis, feature)``: for each fold those that its training part gave.

        Returns
        -------
        ``(axis, target)``: cross-validated share of variance, by straight lines.
        """
        sums = self._target_sums(targets[..., None])
        error = np.zeros((directions.shape[1], targets.shape[1]))
        for fold, axes in zip(self.folds, directions, strict=True):
            if fold is None:
                continue
            scale = axes @ fold.basis[0]
            across = scale @ self._slope(fold, sums)[0]
            own = np.square(scale) @ fold.eigenvalues[0]
            gain = across / np.where(own > 0, own, 1.0)[:, None]
            squares, cross = self._tested(fold, sums)
            spread = np.einsum("af,fg,ag->a", scale, fold.tested[0], scale)
            error += squares[..., 0] - 2.0 * gain * (scale @ cross[0])
            error += np.square(gain) * spread[:, None]
        total = np.square(targets - targets.mean(0)).sum(0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(total > 0, 1.0 - error / total, np.nan)

    def canonical(self, targets: Array, penalty: float = 1e-2) -> Array:
        """Return canonical correlations with a set of targets, on frames that were left out.

        Parameters
        ----------
        targets
            ``(sample, target)``.
        penalty
            Added to the variances of the features, and of the standardised targets.

        Returns
        -------
        ``(group, canonical)``, as many as there are of the fewer: the correlation that the pairs of
        directions of the training part have in the tested part, averaged over folds. One may be
        negative if there is none.
        """
        spread = targets.std(0)
        targets = (targets - targets.mean(0)) / np.where(spread > 0, spread, 1.0)
        sums = self._target_sums(targets[..., None])
        ordered = targets[self.cells.order]
        square = np.stack([ordered[part].T @ ordered[part] for part in self.cells.slices])
        found, weights = [], []
        for fold in self.folds:
            if fold is None:
                continue
            trained = _covariance(fold.train, self.count, sums.sum, square)
            values, basis = np.linalg.eigh(trained)
            whiten = basis / np.sqrt(values.clip(0.0) + penalty)
            root = np.sqrt(fold.eigenvalues + penalty)[..., None]
            left, _, right = np.linalg.svd(
                self._slope(fold, sums) / root @ whiten, full_matrices=False
            )
            left, right = left / root, whiten @ right.swapaxes(-1, -2)
            tested = _covariance(fold.test, self.count, sums.sum, square)
            count = self.count[fold.test].sum()
            within = fold.tested / count - fold.shift[..., None] * fold.shift[..., None, :]
            cross = self._tested_covariance(fold, sums)
            across = np.einsum("gfc,gft,gtc->gc", left, cross, right)
            sizes = np.einsum("gfc,gfh,ghc->gc", left, within, left)
            others = np.einsum("gtc,tu,guc->gc", right, tested, right)
            product = (sizes * others).clip(0.0)
            found.append(
                np.where(product > 0, across / np.sqrt(np.where(product > 0, product, 1)), 0)
            )
            weights.append(count)
        return np.average(np.stack(found), axis=0, weights=weights)

    @property
    def training_cells(self) -> list[Mask]:
        """For each fold, which cells train it."""
        return [fold.train for fold in self.folds if fold is not None]

    def _prepare(self, train: Mask, test: Mask) -> "_Fold | None":
        """Standardise and diagonalise a training part; ``None`` if a part is empty."""
        if self.count[train].sum() < 2 or not self.count[test].sum():
            return None
        # The same frames train when two folds are left out in either order.
        key = train.tobytes()
        if key not in self.trained:
            self.trained[key] = self._train(train)
        count, mean, turn, eigenvalues = self.trained[key]
        tested, total = self.square[test].sum(0), self.sum[test].sum(0)
        number = self.count[test].sum()
        outer = total[..., None] * mean[..., None, :]
        tested = tested - outer - outer.swapaxes(-1, -2)
        tested = tested + number * mean[..., None] * mean[..., None, :]
        shift = np.einsum("gfe,gf->ge", turn, total / number - mean)
        return _Fold(
            train,
            test,
            count,
            mean,
            turn,
            eigenvalues,
            turn.swapaxes(-1, -2) @ tested @ turn,
            shift,
        )

    def _train(self, train: Mask) -> "_Trained":
        """Return count, mean, eigenvectors and eigenvalues of a training part."""
        count = self.count[train].sum()
        mean = self.sum[train].sum(0) / count
        covariance = self.square[train].sum(0) / count - mean[..., None] * mean[..., None, :]
        eigenvalues, basis = np.linalg.eigh(covariance)
        return float(count), mean, basis, eigenvalues.clip(0.0)

    def _target_sums(self, targets: Array) -> "_TargetSums":
        """Return sums over each cell of targets ``(sample, target, component)``."""
        shape = targets.shape[1:]
        flat = targets.reshape(len(targets), -1)
        flat = (flat - flat.mean(0))[self.cells.order]
        groups, _, features = self.features.shape
        cross = np.empty((len(self.count), groups, features, flat.shape[1]))
        total = np.empty((len(self.count), flat.shape[1]))
        square = np.empty_like(total)
        for index, cell in enumerate(self.cells.slices):
            part = flat[cell]
            cross[index] = self.features[:, cell].swapaxes(1, 2) @ part
            total[index] = part.sum(0)
            square[index] = np.einsum("st,st->t", part, part)
        return _TargetSums(shape, total, square, cross)

    def _slope(self, fold: _Fold, sums: "_TargetSums") -> Array:
        """Return the covariance of features, in the eigenbasis, with targets in training."""
        mean = sums.sum[fold.train].sum(0) / fold.count
        cross = sums.cross[fold.train].sum(0) / fold.count - fold.mean[..., None] * mean
        turned: Array = fold.basis.swapaxes(-1, -2) @ cross
        return turned

    def _tested(self, fold: _Fold, sums: "_TargetSums") -> tuple[Array, Array]:
        """Return sums of squares and products in the tested part, about the means of training."""
        mean = sums.sum[fold.train].sum(0) / fold.count
        number = self.count[fold.test].sum()
        total = sums.sum[fold.test].sum(0)
        squares = sums.square[fold.test].sum(0) - 2.0 * mean * total + number * mean**2
        cross = sums.cross[fold.test].sum(0)
        own = self.sum[fold.test].sum(0)[..., None]
        cross = cross - own * mean - fold.mean[..., None] * (total - number * mean)
        turned: Array = fold.basis.swapaxes(-1, -2) @ cross
        return squares.reshape(sums.shape), turned

    def _tested_covariance(self, fold: _Fold, sums: "_TargetSums") -> Array:
        """Return the covariance of features, in the eigenbasis, with targets in the tested part."""
        _, cross = self._tested(fold, sums)
        number = self.count[fold.test].sum()
        mean = sums.sum[fold.train].sum(0) / fold.count
        moved = sums.sum[fold.test].sum(0) / number - mean
        return np.asarray(cross / number - fold.shift[..., None] * moved)

    def _error(self, fold: _Fold, inner: "list[_Fold]", sums: "_TargetSums") -> Array:
        """Return squared errors ``(group, target, component)`` in the tested part of a fold."""
        chosen = np.zeros((len(self.features), sums.shape[0]), dtype=int)
        if inner:
            tried = sum(self._errors(part, sums).sum(-1) for part in inner)
            chosen = np.argmin(tried, axis=0)
        errors = self._errors(fold, sums)
        return np.asarray(np.take_along_axis(errors, chosen[None, ..., None], 0)[0])

    def _errors(self, fold: _Fold, sums: "_TargetSums") -> Array:
        """Return squared errors with each penalty, ``(penalty, group, target, component)``."""
        slope = self._slope(fold, sums)
        squares, cross = self._tested(fold, sums)
        groups = len(self.features)
        errors = np.empty((len(self.penalties), groups, *sums.shape))
        for place, penalty in enumerate(self.penalties):
            weight = slope / (fold.eigenvalues[..., None] + penalty)
            change = np.einsum("gft,gft->gt", weight, fold.tested @ weight - 2.0 * cross)
            errors[place] = squares + change.reshape(groups, *sums.shape)
        return errors


@dataclass(frozen=True)
class _TargetSums:
    """Sums over each cell: of targets, of their squares, and of features times targets."""

    shape: tuple[int, ...]
    sum: Array
    square: Array
    cross: Array


def _covariance(part: Mask, count: Array, sums: Array, squares: Array) -> Array:
    """Return the covariance matrix over some cells."""
    number = count[part].sum()
    mean = sums[part].sum(0) / number
    covariance: Array = squares[part].sum(0) / number - mean[:, None] * mean
    return covariance
