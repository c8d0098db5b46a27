r"""Who sees whom when bodies hide each other: the two-dimensional visual field.

The graph of section 3.6 of the thesis, computed from positions and headings alone, in the manner
of the tracker TRex [1]_, which computes it from outlines: each individual has two eyes, each eye
casts a fan of rays, a ray ends at the first body that it meets, and j is seen by i when at least
one ray of either eye of i ends at j.

Bodies are ellipses around the tracked position, their long axis along the heading. An eye's own
body hides nothing; the blind angle behind the animal stands for it. Rays are cast exactly (an
ellipse becomes the unit circle when its axes are scaled), and only towards the bodies that an eye's
rays can meet: the tangents to a body enclose a run of neighbouring rays, and only those are tried.

References
----------
.. [1] Walter and Couzin (2021), eLife 10:e64000.
"""

import dataclasses
import math

import numpy as np
import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs.compiled_rays import first_hits
from swarmssm.graphs.neighbors import check_positions, pairs, portions

__all__ = ["visual_field_graph"]

#: Distance of the eyes from the middle of the body towards the snout, in body lengths.
EYE_OFFSET = 0.35
#: Rays followed at once; each needs some 150 bytes.
RAYS_AT_ONCE = 1_000_000
#: What the eye sees when nothing is in the way of a ray: a code above that of every hit.
NOTHING = torch.iinfo(torch.int64).max


def visual_field_graph(
    positions: Tensor,
    headings: Tensor,
    *,
    body_length: float,
    body_width: float | None = None,
    blind_angle: float = 30.0,
    eye_field: float = 260.0,
    eyes: int = 2,
    rays: int = 512,
    max_distance: float | None = None,
) -> Tensor:
    """Return who sees whom, bodies hiding what is behind them.

    Parameters
    ----------
    positions
        Shape ``(..., individual, 2)``: middle of the body. NaN = absent: neither sees, nor is
        seen, nor hides anything.
    headings
        Same shape, of any length: where the animal looks, for instance its velocity (see
        :func:`~swarmssm.graphs.headings_from_velocity`). Who has none (NaN or zero) sees nobody,
        and its body is a disc of the same area.
    body_length, body_width
        Long and short diameter of the body, in the unit of ``positions``. The width is a quarter
        of the length if absent.
    blind_angle
        Whole angle behind the animal that neither eye reaches, in **degrees**, from 0 to below 360.
    eye_field
        What one eye spans, in degrees; 260 as in TRex. It ends at the blind angle on its own side
        and reaches across the front to the other side, at most to the blind angle there.
    eyes
        2: one on each side of the head, on the outline of the body, 0.35 body lengths before its
        middle. 1: a single eye on the midline, which sees everything but the blind angle.
    rays
        Number of rays of one eye, evenly spread over its field, both ends included. A body that
        falls between two rays is not seen: 512 rays are half a degree apart.
    max_distance
        Length of the rays, from the eye; unbounded if absent.

    Returns
    -------
    Shape ``(..., individual, individual)``, bool, ``[i, j]`` true when i sees j; in general not
    symmetric. The diagonal is false. An eye that lies inside bodies sees these bodies alone.

    Raises
    ------
    InputError
        If the positions are not two-dimensional, the shapes differ, or a parameter is out of range.

    Notes
    -----
    Memory beyond the result is bounded; the time grows with the number of rays that meet bodies.
    On the processor a compiled loop casts the rays, in double precision whatever the dtype; on
    other devices tensors do, in the dtype of the positions.
    """
    check_positions(positions)
    check_positions(headings, "headings")
    if positions.shape[-1] != 2:
        raise InputError("positions: a visual field is computed in two dimensions only, not in 3.")
    if headings.shape != positions.shape:
        raise InputError(
            f"headings: their shape {tuple(headings.shape)} differs from that of the positions, "
            f"{tuple(positions.shape)}."
        )
    if body_width is None:
        body_width = 0.25 * body_length
    _check_anatomy(body_length, body_width, blind_angle, eye_field, eyes, rays, max_distance)
    field, axes = _eye_axes(blind_angle, eye_field, eyes)
    reach = math.inf if max_distance is None else max_distance
    anatomy = _Anatomy(body_length, body_width, axes, field, rays, reach)

    num_members = positions.shape[-2]
    places = positions.detach().reshape(-1, num_members, 2).contiguous()
    looks = headings.detach().reshape(-1, num_members, 2).contiguous()
    on_cpu = positions.device.type == "cpu"
    seen = _by_loop(places, looks, anatomy) if on_cpu else _by_tensors(places, looks, anatomy)
    return seen.reshape(*positions.shape[:-1], num_members)


def _check_anatomy(
    body_length: float,
    body_width: float,
    blind_angle: float,
    eye_field: float,
    eyes: int,
    rays: int,
    max_distance: float | None,
) -> None:
    """Refuse bodies and eyes that cannot be."""
    lengths = {"body_length": body_length, "body_width": body_width, "max_distance": max_distance}
    for name, value in lengths.items():
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{name}: it must be a positive number, not {value}.")
    if not 0.0 <= blind_angle < 360.0:
        raise InputError(f"blind_angle: it must be from 0 to below 360 degrees, not {blind_angle}.")
    if not 0.0 < eye_field <= 360.0:
        raise InputError(f"eye_field: it must be above 0 and at most 360 degrees, not {eye_field}.")
    if eyes not in (1, 2):
        raise InputError(f"eyes: there can be 1 or 2, not {eyes}.")
    if isinstance(rays, bool) or not isinstance(rays, int | np.integer) or rays < 2:
        raise InputError(f"rays: each eye needs a whole number of rays, at least 2, not {rays}.")


def _eye_axes(blind_angle: float, eye_field: float, eyes: int) -> tuple[float, list[float]]:
    """Return the field of one eye and where the middle of each eye's field points, in radians.

    Angles are counted anticlockwise from the heading; the left eye comes first.
    """
    clear = 360.0 - blind_angle
    if eyes == 1:
        return math.radians(clear), [0.0]
    field = min(eye_field, clear)
    axis = math.radians(0.5 * (clear - field))
    return math.radians(field), [axis, -axis]


@dataclasses.dataclass(frozen=True)
class _Anatomy:
    """Body and eyes: lengths in the unit of the positions, angles in radians."""

    length: float
    width: float
    #: Where the middle of each eye's field points, from the heading.
    axes: list[float]
    field: float
    rays: int
    reach: float

    @property
    def disc(self) -> float:
        """Radius of the disc of the same area."""
        return 0.5 * math.sqrt(self.length * self.width)


def _by_loop(places: Tensor, looks: Tensor, anatomy: _Anatomy) -> Tensor:
    """Cast the rays one after the other, in double precision on the processor."""
    half_length, half_width = 0.5 * anatomy.length, 0.5 * anatomy.width
    along, across = _eye_on_outline()
    sides = [1.0, -1.0] if len(anatomy.axes) == 2 else [0.0]
    seen = first_hits(
        places.double().numpy(),
        looks.double().numpy(),
        lengths=np.array([half_length, half_width, anatomy.disc]),
        eyes=np.array([[along * half_length, side * across * half_width] for side in sides]),
        axes=np.array(anatomy.axes),
        field=anatomy.field,
        rays=anatomy.rays,
        reach=anatomy.reach,
    )
    return torch.from_numpy(seen)


def _by_tensors(places: Tensor, looks: Tensor, anatomy: _Anatomy) -> Tensor:
    """Cast the rays of many frames at once, for other devices."""
    num_frames, num_members, _ = places.shape
    axes, rays = anatomy.axes, anatomy.rays
    seen = torch.empty(
        (num_frames, num_members, num_members), dtype=torch.bool, device=places.device
    )
    for rows in portions(num_frames, 8 * len(axes) * num_members * max(num_members, rays)):
        bodies = _Bodies.of(places[rows], looks[rows], anatomy)
        seen[rows] = _first_hits(bodies, _Fan.of(bodies, anatomy), anatomy.reach)
    return seen


def _eye_on_outline() -> tuple[float, float]:
    """Return where the left eye sits, in half lengths along the body and half widths across it."""
    # An ellipse is sqrt(1 - x ** 2) of its width wide at the fraction x of its half length.
    return 2.0 * EYE_OFFSET, math.sqrt(1.0 - (2.0 * EYE_OFFSET) ** 2)


# Below, points and directions of the plane are complex numbers: a product with a unit number turns,
# one with its conjugate expresses in its frame, and 1j is a quarter turn to the left.


@dataclasses.dataclass(frozen=True)
class _Bodies:
    """Ellipses, all ``(frame, individual)``; ``center`` and the unit ``axis`` are complex."""

    center: Tensor
    axis: Tensor
    half_length: Tensor
    half_width: Tensor
    present: Tensor
    looking: Tensor

    @classmethod
    def of(cls, places: Tensor, looks: Tensor, anatomy: _Anatomy) -> "_Bodies":
        """Make a body of everyone present, a disc where the heading is not known."""
        present = places.isfinite().all(-1)
        norm = torch.linalg.vector_norm(looks, dim=-1)
        has_heading = (norm > 0) & norm.isfinite()
        unit = torch.where(has_heading, norm, 1.0)[..., None]
        forward = looks.new_tensor([1.0, 0.0])
        half_length, half_width, disc = 0.5 * anatomy.length, 0.5 * anatomy.width, anatomy.disc
        return cls(
            center=torch.view_as_complex(torch.where(present[..., None], places, 0.0)),
            axis=torch.view_as_complex(torch.where(has_heading[..., None], looks / unit, forward)),
            half_length=torch.where(has_heading, half_length, disc).to(places.dtype),
            half_width=torch.where(has_heading, half_width, disc).to(places.dtype),
            present=present,
            looking=present & has_heading,
        )


@dataclasses.dataclass(frozen=True)
class _Fan:
    """The rays of all eyes: complex ``origin`` and unit ``axis``, ``(frame, individual, eye)``."""

    origin: Tensor
    axis: Tensor
    field: float
    rays: int

    @classmethod
    def of(cls, bodies: _Bodies, anatomy: _Anatomy) -> "_Fan":
        """Put two eyes on the outline of the body, left first, or one on its midline."""
        eye_along, eye_across = _eye_on_outline()
        along, across = eye_along * bodies.half_length, eye_across * bodies.half_width
        axes = anatomy.axes
        side = along.new_tensor([1.0, -1.0] if len(axes) == 2 else [0.0])
        eye = along[..., None] + 1j * side * across[..., None]
        turn = torch.exp(1j * along.new_tensor(axes))
        ahead = bodies.axis[..., None]
        return cls(
            bodies.center[..., None] + eye * ahead, turn * ahead, anatomy.field, anatomy.rays
        )


def _first_hits(bodies: _Bodies, fan: _Fan, reach: float) -> Tensor:
    """Cast the rays of some frames; return ``(frame, individual, individual)``, i sees j."""
    num_frames, num_members, num_eyes = fan.origin.shape
    candidates = (pairs(bodies.present) & bodies.looking[..., None])[:, :, None, :]
    candidates = candidates.expand(-1, -1, num_eyes, -1)
    frame, viewer, eye, target = candidates.nonzero(as_tuple=True)
    body = frame * num_members + target
    watcher = (frame * num_members + viewer) * num_eyes + eye
    sight = _Sight.of(bodies, fan, watcher, body)

    pair, first, count = _ray_runs(sight, fan.field, fan.rays)
    nearest = torch.full(
        (fan.origin.numel() * fan.rays,), NOTHING, dtype=torch.int64, device=pair.device
    )
    angles = torch.linspace(-0.5 * fan.field, 0.5 * fan.field, fan.rays, dtype=torch.float64)
    cos, sin = (f.to(bodies.half_length) for f in (angles.cos(), angles.sin()))
    quadratics = sight.quadratics()
    for runs in _bounded_groups(count):
        run = runs.repeat_interleave(count[runs])
        begin = (count[runs].cumsum(0) - count[runs]).repeat_interleave(count[runs])
        ray = first[run] + torch.arange(len(run), device=run.device) - begin
        seen_from = pair[run]
        depth = _depth(quadratics[seen_from], cos[ray], sin[ray])
        # Distance above, individual below: the smallest code is the nearest hit, and of two at the
        # same distance the individual of lower index. A float of 32 bits that is not negative
        # keeps its order when its bits are read as a whole number.
        code = (depth.float().view(torch.int32).long() << 32) | target[seen_from]
        code = torch.where(depth <= reach, code, NOTHING)
        nearest.scatter_reduce_(0, watcher[seen_from] * fan.rays + ray, code, "amin")

    seen = torch.zeros(
        num_frames * num_members, num_members, dtype=torch.bool, device=nearest.device
    )
    hit = (nearest != NOTHING).nonzero().squeeze(-1)
    seen[hit // (num_eyes * fan.rays), nearest[hit] & 0xFFFFFFFF] = True
    inside = quadratics[:, 5] <= 0.0
    seen[watcher[inside] // num_eyes, target[inside]] = True
    return seen.reshape(num_frames, num_members, num_members)


@dataclasses.dataclass(frozen=True)
class _Sight:
    """One body seen from one eye, for many pairs at once: all tensors ``(pair,)``.

    In the frame of the body, ``eye`` is the place of the eye and ``look`` the middle of its field.
    """

    eye: Tensor
    look: Tensor
    half_length: Tensor
    half_width: Tensor

    @classmethod
    def of(cls, bodies: _Bodies, fan: _Fan, watcher: Tensor, body: Tensor) -> "_Sight":
        """Gather pairs of flat indices: ``watcher`` of an eye, ``body`` of an individual."""
        into_frame = bodies.axis.reshape(-1)[body].conj().resolve_conj()
        offset = fan.origin.reshape(-1)[watcher] - bodies.center.reshape(-1)[body]
        return cls(
            eye=offset * into_frame,
            look=fan.axis.reshape(-1)[watcher] * into_frame,
            half_length=bodies.half_length.reshape(-1)[body],
            half_width=bodies.half_width.reshape(-1)[body],
        )

    def tangents(self) -> tuple[Tensor, Tensor]:
        """Return the angles, from the middle of the eye's field, between which the body lies.

        The first is from -pi to pi, the second further anticlockwise by less than half a turn, or
        by a full turn when the eye lies inside the body.
        """
        x, y = self.eye.real / self.half_length, self.eye.imag / self.half_width
        squared = x.square() + y.square()
        outside = squared > 1.0
        squared = torch.where(outside, squared, 4.0)
        # Where the tangents from q touch the unit circle: q / |q|^2 -+ sqrt(|q|^2 - 1) / |q|^2 i q.
        aside = (squared - 1.0).sqrt()
        right = self._from_circle((x - aside * y) / squared, (y + aside * x) / squared)
        left = self._from_circle((x + aside * y) / squared, (y - aside * x) / squared)
        start = ((right - self.eye) * self.look.conj()).angle()
        width = ((left - self.eye) * (right - self.eye).conj()).angle().clamp(min=0.0)
        start = torch.where(outside, start, -math.pi)
        return start, torch.where(outside, start + width, math.pi)

    def _from_circle(self, x: Tensor, y: Tensor) -> Tensor:
        """Scale a point by the half axes: from the unit circle to the outline of the body."""
        return torch.complex(self.half_length * x, self.half_width * y)

    def quadratics(self) -> Tensor:
        """Return what the distance along a ray depends on, shape ``(pair, 6)``.

        In units of the half axes the body is the unit circle, the eye a point q, and the ray at
        angle t from the middle of the field is ``q + s (cos t l + sin t m)``. It meets the circle
        where ``a s^2 + 2 b s + c = 0``, and a, b and c are made of the products of q, l and m.
        """
        qx, qy = self.eye.real / self.half_length, self.eye.imag / self.half_width
        lx, ly = self.look.real / self.half_length, self.look.imag / self.half_width
        mx, my = -self.look.imag / self.half_length, self.look.real / self.half_width
        return torch.stack(
            [
                lx * lx + ly * ly,
                2.0 * (lx * mx + ly * my),
                mx * mx + my * my,
                qx * lx + qy * ly,
                qx * mx + qy * my,
                qx * qx + qy * qy - 1.0,
            ],
            -1,
        )


def _depth(quadratics: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Return the distance at which a ray between the tangents meets a body, 0 if it starts inside.

    Parameters
    ----------
    quadratics
        Shape ``(ray, 6)``, see :meth:`_Sight.quadratics`.
    cos, sin
        Of the ray's angle from the middle of the field, shape ``(ray,)``.
    """
    ll, lm, mm, ql, qm, c = quadratics.unbind(-1)
    a = ll * cos.square() + lm * cos * sin + mm * sin.square()
    b = ql * cos + qm * sin
    # Between the tangents the discriminant is not negative, but for rounding where they touch.
    root = (b.square() - a * c).clamp(min=0.0).sqrt()
    return torch.where(c > 0.0, (-b - root) / a, 0.0).clamp(min=0.0)


def _ray_runs(sight: _Sight, field: float, rays: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return runs of neighbouring rays that meet a body: pair, first ray, number of rays.

    A body behind the eye may span the half turn, where the fan's two ends come together: it has a
    run at the last rays and another at the first.
    """
    start, stop = sight.tangents()
    behind = (stop > math.pi).nonzero().squeeze(-1)
    pair = torch.cat([torch.arange(len(start), device=start.device), behind])
    start = torch.cat([start, start[behind] - 2.0 * math.pi])
    stop = torch.cat([stop, stop[behind] - 2.0 * math.pi])
    spacing = field / (rays - 1)
    first = ((start + 0.5 * field) / spacing).ceil().clamp(min=0).long()
    last = ((stop + 0.5 * field) / spacing).floor().clamp(max=rays - 1).long()
    return pair, first, (last - first + 1).clamp(min=0)


def _bounded_groups(count: Tensor) -> list[Tensor]:
    """Split the runs that hold any ray into groups of at most about :data:`RAYS_AT_ONCE` rays."""
    met = count.nonzero().squeeze(-1)
    if not len(met):
        return []
    group = (count[met].cumsum(0) - 1) // RAYS_AT_ONCE
    return list(torch.split(met, torch.bincount(group).tolist()))
