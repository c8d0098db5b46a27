"""Smoothing of one body, each axis for itself: two by two blocks in closed form."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from swarmssm.inference.guides.chains import (
    Chain,
    Law,
    NeighborTerm,
    Observations,
    Spread,
    Start,
    Steps,
    presence_transitions,
)
from swarmssm.inference.guides.mean_paths import mean_paths
from swarmssm.models.scans import linear_scan, projective_scan

__all__ = ["KinematicChain"]


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
        self.state_dim, self.noise_dim = 2 * space, space

    def _messages(self, sightings: Observations, law: Law, persists: Tensor) -> _Axis:
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
        keep = persists.unsqueeze(-1).to(drift.dtype).movedim(1, 0)
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

    def steps(
        self, sightings: Observations, law: Law, start: Start, present: Tensor
    ) -> "AxisSteps":
        """Return the conditional distributions; see :meth:`Chain.steps`."""
        persists, enters = presence_transitions(present)
        axis = self._messages(sightings, law, persists)
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
            persists=persists,
            enters=enters,
            dt=dt,
            message=first,
            from_position=share * k - variance * m,
            from_velocity=share * a,
            share=share,
            offset=offset,
            variance=variance,
        )

    def mean(self, sightings: Observations, law: Law, start: Start, present: Tensor) -> Tensor:
        """Return the mean path; see :meth:`Chain.mean`."""
        if present.device.type != "cpu":
            # Steps of many small operations, which only a processor of few columns likes.
            return super().mean(sightings, law, start, present)
        persists, enters = presence_transitions(present)
        shape = sightings.location.shape
        sure = torch.where(enters.unsqueeze(-1), start.variance.reciprocal(), 0.0)
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
            columns(persists.unsqueeze(-1).expand(each)),
            columns(enters.unsqueeze(-1).expand(half)),
        )
        if found is None:
            return super().mean(sightings, law, start, present)
        back = (shape[0], *half[2:], shape[1])
        return torch.cat([part.reshape(back).movedim(-1, 1) for part in found], -1)

    def spread(self, sightings: Observations, law: Law, start: Start, present: Tensor) -> Spread:
        """Return the scales of independent velocities; see :meth:`Chain.spread`."""
        persists, _ = presence_transitions(present)
        persists = persists.unsqueeze(-1).to(law.drift.dtype)
        seen_p, seen_v = sightings.precision.chunk(2, -1)
        # A velocity shifts all later positions until its individual leaves.
        if bool(present.all()):
            shifted = seen_p.flip(1).cumsum(1).flip(1)
        else:
            onward = functional.pad(persists, (0, 0, 0, 0, 0, 1)).expand_as(seen_p).movedim(1, 0)
            shifted = linear_scan(onward, seen_p.movedim(1, 0), reverse=True).movedim(0, 1)
        a = law.gains[1].expand_as(law.drift)
        before = persists * a.square() / law.noise
        before = torch.cat([before, torch.zeros_like(seen_p[:, :1])], 1)
        free = 1.0 / law.noise + before[:, 1:] + self.dt**2 * shifted[:, 1:] + seen_v[:, 1:]
        sure_p, sure_v = start.variance.reciprocal().expand_as(sightings.location).chunk(2, -1)
        first = torch.cat([shifted + sure_p, seen_v + before + sure_v], -1)
        return Spread(first.rsqrt(), free.rsqrt())

    def join(self, first: Tensor, free: Tensor, present: Tensor) -> Tensor:
        """Return the path; see :meth:`Chain.join`."""
        persists, enters = presence_transitions(present)
        persists, enters = persists.unsqueeze(-1), enters.unsqueeze(-1)
        free = torch.where(persists, free, 0.0)
        first_p, first_v = torch.where(enters[:, : first.shape[1]], first, 0.0).chunk(2, -1)
        if first.shape[1] == 1:
            v = torch.cat([first_v, free], 1)
            p = torch.cat([first_p, self.dt * free], 1).cumsum(1)
            # Who has left is nowhere.
            return torch.cat([torch.where(present.unsqueeze(-1), p, 0.0), v], -1)
        v = torch.cat([first_v[:, :1], first_v[:, 1:] + free], 1)
        onward = functional.pad(persists.to(v.dtype), (0, 0, 0, 0, 1, 0)).expand_as(v)
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

    def walk(self, first: Tensor, shift: Tensor | None, pull: NeighborTerm | None) -> Tensor:
        """Return the path: in one scan, or step by step where neighbours pull."""
        if pull is None:
            return self._scan(first, self.offset if shift is None else self.offset + shift)
        gain_p, gain_v = self.from_position.unbind(1), self.from_velocity.unbind(1)
        offset = (self.offset if shift is None else self.offset + shift).unbind(1)
        share = self.share.unbind(1)
        persists = self.persists.unsqueeze(-1).unbind(1)
        arrived = torch.where(self.enters.unsqueeze(-1), first, 0.0).unbind(1)
        state = arrived[0]
        path = [state]
        for t, moved in enumerate(offset):
            p, v = state.chunk(2, -1)
            v = moved + gain_p[t] * p + gain_v[t] * v + share[t] * pull(t, state)
            state = torch.where(persists[t], torch.cat([p + self.dt * v, v], -1), arrived[t + 1])
            path.append(state)
        return torch.stack(path, 1)

    def _scan(self, first: Tensor, offset: Tensor) -> Tensor:
        """Return the path when neighbours do not pull."""
        dt = self.dt
        persists = self.persists.unsqueeze(-1).to(offset.dtype)
        gain_p, gain_v = self.from_position * persists, self.from_velocity * persists
        gain = torch.stack([persists + dt * gain_p, dt * gain_v, gain_p, gain_v], -1)
        arrived = torch.where(self.enters.unsqueeze(-1), first, 0.0)
        arrived = torch.stack(arrived.chunk(2, -1), -1)
        moved = torch.where(self.persists.unsqueeze(-1), offset, 0.0)
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
