r"""Exact smoothing of one individual: what is seen later, as a Gaussian message at each frame.

Given the state before, the posterior of the next state needs what is seen from there on, and
nothing else: :math:`p(z_t | z_{t-1}, x) \propto p(z_t | z_{t-1})\, p(x_{t:T} | z_t)`. The second
factor, a Gaussian in information form, comes from one recursion backwards in time. All individuals
of all windows go through it together.

States are deviations from a reference path, so that nothing is lost to rounding where positions are
large and the noise is small.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from swarmssm.inference.guides.mean_paths import mean_paths
from swarmssm.models.scans import linear_scan, projective_scan

__all__ = [
    "Chain",
    "FullChain",
    "KinematicChain",
    "Law",
    "Pull",
    "Sightings",
    "Start",
    "Steps",
]

HALF_LOG_TWO_PI = 0.9189385332046727

#: From a step and the deviations before it, ``(batch, individual, state)``, to what neighbours add
#: to the mean of the free features, ``(batch, individual, free)``.
Pull = Callable[[int, Tensor], Tensor]


class Sightings(NamedTuple):
    """Independent Gaussian sightings of each feature of a state.

    Attributes
    ----------
    location
        As a deviation from the reference, ``(batch, time, individual, state)``.
    precision
        Same shape; 0 where nothing was seen.
    """

    location: Tensor
    precision: Tensor


class Law(NamedTuple):
    r"""Affine law of one individual, :math:`\mu_t = J_t z_{t-1} + u_t`, noise of covariance
    :math:`Q_t`, for the free features of the next state.

    Attributes
    ----------
    drift
        u, ``(batch, time - 1, individual, free)``.
    noise
        Q: variances ``(batch, time - 1, individual, free)`` in a :class:`KinematicChain`, lower
        triangular square roots ``(..., free, free)`` in a :class:`FullChain`.
    gains
        J: what position and velocity of an axis do to its next velocity, each broadcasting against
        ``drift``; or one matrix that broadcasts against ``(..., free, state)``.
    """

    drift: Tensor
    noise: Tensor
    gains: tuple[Tensor, ...]


class Start(NamedTuple):
    """Mean, as a deviation from the reference, and variance of a first state, each
    ``(batch, time, individual, state)`` or broadcasting to it.
    """

    mean: Tensor
    variance: Tensor


@dataclass(frozen=True)
class Steps(ABC):
    """Conditional distributions of each free feature, given the state before.

    Attributes
    ----------
    stays, comes
        ``(batch, time - 1, individual)`` who is there at both ends of a step, and
        ``(batch, time, individual)`` who is there for the first time; of bool.
    """

    stays: Tensor
    comes: Tensor

    @abstractmethod
    def first(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return first states for each frame, from standard noise ``(batch, time, individual,
        state)``, and the logarithm of the determinant of their scale ``(batch, time, individual)``.
        """

    @abstractmethod
    def scaled(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return standard noise ``(batch, time - 1, individual, free)`` at its scale, and the
        logarithm of the determinant of the scale.
        """

    @abstractmethod
    def walk(self, first: Tensor, shift: Tensor | None, pull: Pull | None) -> Tensor:
        """Return the path, step by step.

        Parameters
        ----------
        first
            ``(batch, time, individual, state)``, taken where an individual comes.
        shift
            Added to the means of the free features; absent, the mean path is returned.
        pull
            What neighbours add.
        """

    def draw(
        self, stretch: Tensor, free_stretch: Tensor, pull: Pull | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return a path ``(batch, time, individual, state)`` and its log-density ``(batch,)``.

        Parameters
        ----------
        stretch, free_stretch
            Logarithms of factors by which the noise of first states ``(batch, time, individual,
            state)``, and of free features ``(batch, time - 1, individual, free)``, is larger.
        pull
            What neighbours add.
        """
        first_noise, noise = torch.randn_like(stretch), torch.randn_like(free_stretch)
        first, first_size = self.first(stretch.exp() * first_noise)
        shift, size = self.scaled(free_stretch.exp() * noise)
        path = self.walk(first, shift, pull)
        total = normal_terms(first_noise, first_size + stretch.sum(-1), self.comes)
        return path, total + normal_terms(noise, size + free_stretch.sum(-1), self.stays)

    def mean(self, like: Tensor) -> Tensor:
        """Return the mean path; ``like`` has its shape, and says type and device."""
        first, _ = self.first(torch.zeros_like(like))
        return self.walk(first, None, None)


def normal_terms(noise: Tensor, log_scale: Tensor, there: Tensor) -> Tensor:
    """Return the log-density ``(batch,)`` of what was made from standard noise, where ``there``.

    Parameters
    ----------
    noise
        ``(batch, time, individual, feature)``.
    log_scale
        Logarithm of the determinant of the scale, ``(batch, time, individual)``.
    there
        Same shape, of bool.
    """
    density = -0.5 * noise.square().sum(-1) - noise.shape[-1] * HALF_LOG_TWO_PI - log_scale
    return torch.where(there, density, 0.0).sum((-1, -2))


class Chain(ABC):
    """A kind of law for which messages can be passed backwards.

    Attributes
    ----------
    state_dim, free_dim
        Features of a state, and those of them that noise moves.
    """

    state_dim: int
    free_dim: int

    @abstractmethod
    def steps(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> Steps:
        """Return the conditional distributions of each step given all that is seen from it on.

        Parameters
        ----------
        sightings, law, start
            What is seen, how individuals move, and where they come.
        present
            ``(batch, time, individual)`` of bool.
        """

    def mean(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> Tensor:
        """Return the mean path ``(batch, time, individual, state)``, that of :meth:`steps`."""
        return self.steps(sightings, law, start, present).mean(sightings.location)

    @abstractmethod
    def spread(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> "Spread":
        """Return the scales of a posterior without correlations between features and frames.

        For a linear law these are the optimal ones: the inverse square roots of the diagonal of
        the path's precision, in the coordinates first state and free features.
        """

    @abstractmethod
    def join(self, first: Tensor, free: Tensor, present: Tensor) -> Tensor:
        """Return the path of given first states, taken where an individual comes, and free
        features of all later ones, ``(batch, time, individual, state)``.

        First states are those of all frames; or of the first alone, if nobody comes later.
        """


class Spread(NamedTuple):
    """Scales of independent coordinates: of a first state ``(batch, time, individual, state)``, if
    the individual comes in that frame, and of free features ``(batch, time - 1, individual,
    free)``.
    """

    first: Tensor
    free: Tensor


def who_moves(present: Tensor) -> tuple[Tensor, Tensor]:
    """Return who stays in each step and who comes in each frame."""
    stays = present[:, 1:] & present[:, :-1]
    comes = present.clone()
    comes[:, 1:] &= ~present[:, :-1]
    return stays, comes


@dataclass(frozen=True)
class _Axis:
    r"""Message :math:`\exp(-\frac12 z^\top \Lambda z + \eta^\top z)` on position and velocity of
    one axis. The determinant goes along: by differences it would be lost to rounding.
    """

    pp: Tensor
    pv: Tensor
    vv: Tensor
    det: Tensor
    p: Tensor
    v: Tensor


class KinematicChain(Chain):
    r"""Bodies that move with their next velocity: :math:`v' = k p + a v + u + w,\; p' = p + dt v'`,
    each axis for itself.

    Parameters
    ----------
    space
        Number of axes.
    dt
        Seconds from one frame to the next.
    """

    def __init__(self, space: int, dt: float) -> None:
        self.space, self.dt = space, dt
        self.state_dim, self.free_dim = 2 * space, space

    def _messages(self, sightings: Sightings, law: Law, stays: Tensor) -> _Axis:
        r"""Return what all that is seen from a frame on says of the state there, for each frame.

        A step back changes ``[1, pp, pv, vv, det]`` by a matrix, up to a common factor, and the
        information ``[p, v]`` by an affine function that depends on these.
        """
        seen_p, seen_v, told_p, told_v = (
            part.movedim(1, 0)
            for whole in (sightings.precision, sightings.location * sightings.precision)
            for part in whole.chunk(2, -1)
        )
        shape = law.drift.shape
        drift, noise, k, a = (
            part.expand(shape).movedim(1, 0) for part in (law.drift, law.noise, *law.gains)
        )
        keep = stays.unsqueeze(-1).to(drift.dtype).movedim(1, 0)
        last = [torch.ones_like(seen_p[-1]), seen_p[-1], torch.zeros_like(seen_p[-1]), seen_v[-1]]
        last.append(seen_p[-1] * seen_v[-1])
        gain = self._precision_steps(seen_p[:-1], seen_v[:-1], noise, k, a, keep)
        # The first feature is 1, but its derivative is not 0.
        scaled = projective_scan(_rows(gain, 2), torch.stack(last, -1).flatten(0, -2), reverse=True)
        scaled = scaled.reshape(len(seen_p), *last[0].shape, 5)
        pp, pv, vv, det = (scaled[..., 1:] / scaled[..., :1]).unbind(-1)
        told = [torch.stack([told_p, told_v], -1)]
        if len(drift):
            # Integrate over the next velocity: a message on position and *mean* velocity is left,
            # which is an affine function of the state before.
            m = self.dt * pp[1:] + pv[1:]
            width = self.dt * (m + pv[1:]) + vv[1:]
            share = keep / (1.0 + noise * width)
            into = (k - noise * m) * share
            back = torch.stack([keep + into * self.dt, into, a * share * self.dt, a * share], -1)
            lost = drift * share
            shift = torch.stack([-lost * (m + k * width), -lost * a * width], -1)
            told = [told[0][:-1] + shift, told[0][-1:]]
            back = _rows(torch.unflatten(back, -1, (2, 2)), 2)
        else:
            back = scaled.new_zeros(0, pp[0].numel(), 2, 2)
        back = torch.cat([back, back.new_zeros(1, *back.shape[1:])])
        heard = linear_scan(back, _rows(torch.cat(told), 1), reverse=True)
        p, v = heard.reshape(*pp.shape, 2).unbind(-1)
        return _Axis(*(part.movedim(0, 1) for part in (pp, pv, vv, det, p, v)))

    def _precision_steps(
        self, seen_p: Tensor, seen_v: Tensor, noise: Tensor, k: Tensor, a: Tensor, keep: Tensor
    ) -> Tensor:
        """Return the matrices that carry ``[1, pp, pv, vv, det]`` one frame back, and one more."""
        dt = self.dt
        zero = torch.zeros_like(noise)
        one = zero + 1.0
        moved = 1.0 + k * dt
        common = [one, noise * dt**2, 2.0 * dt * noise, noise, zero]
        pp = [zero, keep * moved.square(), 2.0 * keep * k * moved, keep * k.square(), keep * noise]
        to = keep * a
        pv = [zero, to * dt * moved, to * (2.0 * moved - 1.0), to * k, zero]
        to = to * a
        vv = [zero, to * dt**2, 2.0 * dt * to, to, zero]
        seen = [seen_p * c + q for c, q in zip(common, pp, strict=True)]
        felt = [seen_v * c + q for c, q in zip(common, vv, strict=True)]
        both = [seen_p * x + seen_v * q for x, q in zip(felt, pp, strict=True)]
        both[-1] = both[-1] + to
        rows = torch.stack([*common, *seen, *pv, *felt, *both], -1)
        rows = torch.unflatten(rows, -1, (5, 5))
        return torch.cat([rows, rows.new_zeros(1, *rows.shape[1:])])

    def steps(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> "AxisSteps":
        """Return the conditional distributions; see :meth:`Chain.steps`."""
        stays, comes = who_moves(present)
        axis = self._messages(sightings, law, stays)
        k, a = law.gains
        dt = self.dt
        pp, pv, vv = axis.pp[:, 1:], axis.pv[:, 1:], axis.vv[:, 1:]
        m = dt * pp + pv
        share = 1.0 / (1.0 + law.noise * (dt * (m + pv) + vv))
        variance = law.noise * share
        offset = share * law.drift + variance * (dt * axis.p[:, 1:] + axis.v[:, 1:])
        mean = start.mean.expand(sightings.location.shape)
        sure = start.variance.reciprocal().expand_as(mean)
        sure_p, sure_v = sure.chunk(2, -1)
        told_p, told_v = (mean * sure).chunk(2, -1)
        det = axis.det + sure_p * axis.vv + sure_v * axis.pp + sure_p * sure_v
        first = _Axis(
            axis.pp + sure_p, axis.pv, axis.vv + sure_v, det, axis.p + told_p, axis.v + told_v
        )
        return AxisSteps(
            stays=stays,
            comes=comes,
            dt=dt,
            message=first,
            from_position=share * k - variance * m,
            from_velocity=share * a,
            share=share,
            offset=offset,
            variance=variance,
        )

    def mean(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> Tensor:
        """Return the mean path; see :meth:`Chain.mean`."""
        if present.device.type != "cpu":
            # Steps of many small operations, which only a processor of few columns likes.
            return super().mean(sightings, law, start, present)
        stays, comes = who_moves(present)
        shape = sightings.location.shape
        sure = torch.where(comes.unsqueeze(-1), start.variance.reciprocal(), 0.0)
        told = sightings.location * sightings.precision + sure * start.mean
        half = (*shape[:-1], self.space)

        def columns(part: Tensor) -> Tensor:
            return part.movedim(1, -1).flatten(0, -2)

        each = law.drift.shape
        found = mean_paths(
            self.dt,
            _halves(columns, sightings.precision + sure),
            _halves(columns, told),
            [columns(part.expand(each)) for part in (law.drift, law.noise, *law.gains)],
            columns(stays.unsqueeze(-1).expand(each)),
            columns(comes.unsqueeze(-1).expand(half)),
        )
        if found is None:
            return super().mean(sightings, law, start, present)
        back = (shape[0], *half[2:], shape[1])
        return torch.cat([part.reshape(back).movedim(-1, 1) for part in found], -1)

    def spread(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> Spread:
        """Return the scales of independent velocities; see :meth:`Chain.spread`."""
        stays, _ = who_moves(present)
        stays = stays.unsqueeze(-1).to(law.drift.dtype)
        seen_p, seen_v = sightings.precision.chunk(2, -1)
        # A velocity shifts all later positions until its individual leaves.
        if bool(present.all()):
            shifted = seen_p.flip(1).cumsum(1).flip(1)
        else:
            onward = functional.pad(stays, (0, 0, 0, 0, 0, 1)).expand_as(seen_p).movedim(1, 0)
            shifted = linear_scan(onward, seen_p.movedim(1, 0), reverse=True).movedim(0, 1)
        a = law.gains[1].expand_as(law.drift)
        before = stays * a.square() / law.noise
        before = torch.cat([before, torch.zeros_like(seen_p[:, :1])], 1)
        free = 1.0 / law.noise + before[:, 1:] + self.dt**2 * shifted[:, 1:] + seen_v[:, 1:]
        sure_p, sure_v = start.variance.reciprocal().expand_as(sightings.location).chunk(2, -1)
        first = torch.cat([shifted + sure_p, seen_v + before + sure_v], -1)
        return Spread(first.rsqrt(), free.rsqrt())

    def join(self, first: Tensor, free: Tensor, present: Tensor) -> Tensor:
        """Return the path; see :meth:`Chain.join`."""
        stays, comes = who_moves(present)
        stays, comes = stays.unsqueeze(-1), comes.unsqueeze(-1)
        free = torch.where(stays, free, 0.0)
        first_p, first_v = torch.where(comes[:, : first.shape[1]], first, 0.0).chunk(2, -1)
        if first.shape[1] == 1:
            v = torch.cat([first_v, free], 1)
            p = torch.cat([first_p, self.dt * free], 1).cumsum(1)
            # Who has left is nowhere.
            return torch.cat([torch.where(present.unsqueeze(-1), p, 0.0), v], -1)
        v = torch.cat([first_v[:, :1], first_v[:, 1:] + free], 1)
        onward = functional.pad(stays.to(v.dtype), (0, 0, 0, 0, 1, 0)).expand_as(v)
        shift = torch.cat([first_p[:, :1], first_p[:, 1:] + self.dt * free], 1)
        p = linear_scan(onward.movedim(1, 0), shift.movedim(1, 0)).movedim(0, 1)
        return torch.cat([p, v], -1)


@dataclass(frozen=True)
class AxisSteps(Steps):
    """Steps of a :class:`KinematicChain`: each velocity given position and velocity before.

    Attributes
    ----------
    dt
        Seconds.
    message
        On the first state, that of its prior included.
    from_position, from_velocity, offset, variance
        Mean and variance of the next velocity, ``(batch, time - 1, individual, space)``.
    share
        How much of the law's own mean is left in it, same shape.
    """

    dt: float
    message: _Axis
    from_position: Tensor
    from_velocity: Tensor
    share: Tensor
    offset: Tensor
    variance: Tensor

    def first(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return first states: positions, then velocities given them."""
        m = self.message
        noise_p, noise_v = noise.chunk(2, -1)
        scale_p, scale_v = (m.vv / m.det).sqrt(), m.vv.rsqrt()
        p = (m.vv * m.p - m.pv * m.v) / m.det + scale_p * noise_p
        v = (m.v - m.pv * p) / m.vv + scale_v * noise_v
        return torch.cat([p, v], -1), -0.5 * m.det.log().sum(-1)

    def scaled(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return noise at its scale."""
        return self.variance.sqrt() * noise, 0.5 * self.variance.log().sum(-1)

    def walk(self, first: Tensor, shift: Tensor | None, pull: Pull | None) -> Tensor:
        """Return the path: in one scan, or step by step where neighbours pull."""
        if pull is None:
            return self._scan(first, self.offset if shift is None else self.offset + shift)
        gain_p, gain_v = self.from_position.unbind(1), self.from_velocity.unbind(1)
        offset = (self.offset if shift is None else self.offset + shift).unbind(1)
        share = self.share.unbind(1)
        stays = self.stays.unsqueeze(-1).unbind(1)
        arrived = torch.where(self.comes.unsqueeze(-1), first, 0.0).unbind(1)
        state = arrived[0]
        path = [state]
        for t, moved in enumerate(offset):
            p, v = state.chunk(2, -1)
            v = moved + gain_p[t] * p + gain_v[t] * v + share[t] * pull(t, state)
            state = torch.where(stays[t], torch.cat([p + self.dt * v, v], -1), arrived[t + 1])
            path.append(state)
        return torch.stack(path, 1)

    def _scan(self, first: Tensor, offset: Tensor) -> Tensor:
        """Return the path when neighbours do not pull."""
        dt = self.dt
        stays = self.stays.unsqueeze(-1).to(offset.dtype)
        gain_p, gain_v = self.from_position * stays, self.from_velocity * stays
        gain = torch.stack([stays + dt * gain_p, dt * gain_v, gain_p, gain_v], -1)
        arrived = torch.where(self.comes.unsqueeze(-1), first, 0.0)
        arrived = torch.stack(arrived.chunk(2, -1), -1)
        moved = torch.where(self.stays.unsqueeze(-1), offset, 0.0)
        later = arrived[:, 1:] + torch.stack([dt * moved, moved], -1)
        gain = functional.pad(gain, (0, 0, 0, 0, 0, 0, 1, 0))
        gain = torch.unflatten(gain, -1, (2, 2)).movedim(1, 0)
        shift = torch.cat([arrived[:, :1], later], 1).movedim(1, 0)
        path = linear_scan(_rows(gain, 2), _rows(shift, 1)).reshape(shift.shape).movedim(0, 1)
        return torch.cat([path[..., 0], path[..., 1]], -1)


def _halves(columns: Callable[[Tensor], Tensor], part: Tensor) -> tuple[Tensor, Tensor]:
    """Return positions and velocities, laid out in columns."""
    position, velocity = part.chunk(2, -1)
    return columns(position), columns(velocity)


def _rows(values: Tensor, features: int) -> Tensor:
    """Lay all between time, which is first, and the last dimensions in rows."""
    return values.flatten(1, values.dim() - features - 1)


class FullChain(Chain):
    r"""States in which all features have noise: :math:`z' = J z + u + w`.

    Parameters
    ----------
    state_dim
        Features of a state.
    """

    def __init__(self, state_dim: int) -> None:
        self.state_dim = self.free_dim = state_dim

    def _messages(self, sightings: Sightings, law: Law, stays: Tensor) -> tuple[Tensor, Tensor]:
        """Return precision and information of all that is seen from a frame on, for each frame."""
        (gain,) = law.gains
        gain = gain.expand(*law.drift.shape[:-1], *gain.shape[-2:])
        keep = stays.to(law.drift.dtype)
        seen = torch.diag_embed(sightings.precision)
        told = sightings.location * sightings.precision
        eye = torch.eye(self.state_dim, dtype=seen.dtype, device=seen.device)
        precision, information = seen[:, -1], told[:, -1]
        found = [(precision, information)]
        for t in range(stays.shape[1] - 1, -1, -1):
            root = law.noise[:, t]
            inner = root.mT @ precision @ root
            factor = torch.linalg.cholesky(eye + inner)
            # In the noise's own units; as a product of small terms, not a difference of large ones.
            share = torch.cholesky_solve(inner, factor)
            share = 0.5 * (share + share.mT)
            part = torch.linalg.solve_triangular(root, gain[:, t], upper=False)
            moved = torch.linalg.solve_triangular(root, law.drift[:, t].unsqueeze(-1), upper=False)
            mine = root.mT @ information.unsqueeze(-1)
            heard = torch.cholesky_solve(mine, factor) - share @ moved
            there = keep[:, t, :, None]
            precision = seen[:, t] + there.unsqueeze(-1) * (part.mT @ share @ part)
            information = told[:, t] + there * (part.mT @ heard).squeeze(-1)
            found.append((precision, information))
        found.reverse()
        precisions, informations = zip(*found, strict=True)
        return torch.stack(precisions, 1), torch.stack(informations, 1)

    def steps(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> "FullSteps":
        """Return the conditional distributions; see :meth:`Chain.steps`."""
        stays, comes = who_moves(present)
        precision, information = self._messages(sightings, law, stays)
        (gain,) = law.gains
        root, later = law.noise, precision[:, 1:]
        eye = torch.eye(self.state_dim, dtype=root.dtype, device=root.device)
        factor = torch.linalg.cholesky(eye + root.mT @ later @ root)
        # With C the factor, S = K K' and S Q^-1 = K (C^-1 L^-1), where K = L C^-T.
        scale = torch.linalg.solve_triangular(factor, root.mT, upper=False).mT
        unscaled = torch.linalg.solve_triangular(root, eye.expand_as(root), upper=False)
        unscaled = torch.linalg.solve_triangular(factor, unscaled, upper=False)
        share = scale @ unscaled
        offset = share @ law.drift.unsqueeze(-1)
        offset = offset + scale @ (scale.mT @ information[:, 1:].unsqueeze(-1))
        mean = start.mean.expand(sightings.location.shape)
        sure = start.variance.reciprocal().expand_as(mean)
        first = torch.linalg.cholesky(precision + torch.diag_embed(sure))
        told = (information + mean * sure).unsqueeze(-1)
        size = root.diagonal(dim1=-2, dim2=-1).log() - factor.diagonal(dim1=-2, dim2=-1).log()
        return FullSteps(
            stays=stays,
            comes=comes,
            first_factor=first,
            first_mean=torch.cholesky_solve(told, first).squeeze(-1),
            gain=share @ gain,
            share=share,
            offset=offset.squeeze(-1),
            scale=scale,
            log_size=size.sum(-1),
        )

    def spread(self, sightings: Sightings, law: Law, start: Start, present: Tensor) -> Spread:
        """Return the scales of independent features; see :meth:`Chain.spread`."""
        stays, _ = who_moves(present)
        (gain,) = law.gains
        eye = torch.eye(self.state_dim, dtype=law.noise.dtype, device=law.noise.device)
        inverse = torch.linalg.solve_triangular(law.noise, eye.expand_as(law.noise), upper=False)
        own = inverse.square().sum(-2)
        before = (inverse @ gain).square().sum(-2) * stays.unsqueeze(-1)
        before = torch.cat([before, torch.zeros_like(before[:, :1])], 1)
        seen = sightings.precision
        first = seen + before + start.variance.reciprocal()
        return Spread(first.rsqrt(), (seen[:, 1:] + before[:, 1:] + own).rsqrt())

    def join(self, first: Tensor, free: Tensor, present: Tensor) -> Tensor:
        """Return the path; see :meth:`Chain.join`."""
        stays, comes = who_moves(present)
        first = torch.where(comes.unsqueeze(-1)[:, : first.shape[1]], first, 0.0)
        later = torch.where(stays.unsqueeze(-1), free, first[:, 1:] if first.shape[1] > 1 else 0.0)
        return torch.cat([first[:, :1], later], 1)


@dataclass(frozen=True)
class FullSteps(Steps):
    """Steps of a :class:`FullChain`.

    Attributes
    ----------
    first_factor, first_mean
        Cholesky factor of the precision, and mean, of a first state in each frame.
    gain, share, scale
        ``(batch, time - 1, individual, state, state)``: what the state before, and the law's own
        mean, do to the mean; and a square root of the covariance.
    offset
        ``(batch, time - 1, individual, state)``.
    log_size
        Logarithm of the determinant of ``scale``.
    """

    first_factor: Tensor
    first_mean: Tensor
    gain: Tensor
    share: Tensor
    offset: Tensor
    scale: Tensor
    log_size: Tensor

    def first(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return first states."""
        spread = torch.linalg.solve_triangular(
            self.first_factor.mT, noise.unsqueeze(-1), upper=True
        )
        size = -self.first_factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        return self.first_mean + spread.squeeze(-1), size

    def scaled(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return noise at its scale."""
        return (self.scale @ noise.unsqueeze(-1)).squeeze(-1), self.log_size

    def walk(self, first: Tensor, shift: Tensor | None, pull: Pull | None) -> Tensor:
        """Return the path, step by step."""
        offset = (self.offset if shift is None else self.offset + shift).unbind(1)
        gain, share = self.gain.unbind(1), self.share.unbind(1)
        stays = self.stays.unsqueeze(-1).unbind(1)
        arrived = torch.where(self.comes.unsqueeze(-1), first, 0.0).unbind(1)
        state = arrived[0]
        path = [state]
        for t, moved in enumerate(offset):
            following = moved + (gain[t] @ state.unsqueeze(-1)).squeeze(-1)
            if pull is not None:
                added = pull(t, state).unsqueeze(-1)
                following = following + (share[t] @ added).squeeze(-1)
            state = torch.where(stays[t], following, arrived[t + 1])
            path.append(state)
        return torch.stack(path, 1)
