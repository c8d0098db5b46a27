"""What may tell of forces - the latents of a model, and simpler things beside them - and forces."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property

import numpy as np
import pyro
import torch
import xarray as xr

from swarmssm import forces
from swarmssm.analysis.posterior.accelerations import acceleration_model
from swarmssm.analysis.posterior.inferred_graph import graph_of_steps, step_inputs
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.guides import PathGuide
from swarmssm.inference.prediction import StateSpacePredictor, seeded
from swarmssm.inference.run_folder import Builders, build_modules
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions import NamedFeatures, NamedParts
from swarmssm.tracks import SPACE_NAMES, Array, states_of, stepwise_velocity, with_trials

__all__ = ["View", "forces_on", "latents_of", "untrained"]

#: Terms of the boids law, with a gain of 1.
TERMS = ("cohesion", "separation", "alignment")
DIMS = ("trial", "time", "individual")


def latents_of(fit: Fit, tracks: xr.Dataset) -> xr.DataArray:
    """Return what a model holds to be behind the observations of each individual.

    Of a :class:`~swarmssm.models.OneStepModel` the posterior mean of :math:`z_{t,i}`. Of a
    :class:`~swarmssm.models.StateSpaceModel` the mean of the posterior path, in the tracks' own
    units, and what its law of motion makes of that path: the forces where it has named
    ``terms``, and whatever its transition tells by methods
    ``parts(states, inputs)``, which returns ``(..., part, individual, space)`` named in
    ``part_names``, and ``features(states, inputs)``, which returns ``(..., individual, feature)``
    named in ``feature_names``.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others.

    Returns
    -------
    ``(trial, time, individual, latent)``, NaN where not known, with the coordinates ``latent``,
    names such as ``"vx"``, ``"message 3"``, ``"cohesion x"`` or ``"z1"``, and ``kind (latent)``:
    ``position``, ``velocity``, ``state``, ``force``, ``part``, ``message`` or ``latent``.

    Raises
    ------
    InputError
        If the model cannot predict, or the tracks do not fit it.
    """
    return View(fit, tracks).latents()


def forces_on(fit: Fit, tracks: xr.Dataset) -> xr.DataArray:
    """Return the forces that latents are compared with.

    Of simulated tracks the true ones, their variable ``force``. Of others the terms (3.16), (3.17)
    with n = 1, and (3.18) less one's own velocity, of :mod:`swarmssm.forces`: with gains of 1, on
    the states that the model takes to have been (the smoothed ones, or where it smooths nothing the
    observed ones) and on its graph.

    Parameters
    ----------
    fit, tracks
        As in :func:`latents_of`.

    Returns
    -------
    ``(trial, time, individual, term, space)``, NaN where not known; ``attrs["truth"]`` is 1 for
    true ones.
    """
    return View(fit, tracks).forces()


def untrained(fit: Fit, seeds: Iterable[int]) -> list[Fit]:
    """Return the same model and guide before training, with fresh random weights.

    Parameters
    ----------
    fit
        A fit.
    seeds
        One for each.

    Returns
    -------
    As many as differ: one if nothing in them is random; none, if model or guide came from a
    constructor that the fit does not know by name.
    """
    fresh: list[Fit] = []
    for seed in seeds:
        try:
            with torch.random.fork_rng():
                torch.manual_seed(seed)
                _, model, guide = build_modules(fit.settings, fit.scales, Builders())
        except InputError:
            return []
        one = replace(fit, model=model.eval(), guide=guide.eval())
        if not any(_same(one, other) for other in fresh):
            fresh.append(one)
    return fresh


def _same(one: Fit, other: Fit) -> bool:
    """Return whether two fits have the same weights."""
    return all(
        torch.equal(a, b)
        for first, second in ((one.model, other.model), (one.guide, other.guide))
        for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    )


class View:
    """Tracks as a fitted model sees them, smoothed once for all that is asked.

    Parameters
    ----------
    fit, tracks
        As in :func:`latents_of`.

    Raises
    ------
    InputError
        If the model cannot predict, or the tracks do not fit it.
    """

    def __init__(self, fit: Fit, tracks: xr.Dataset) -> None:
        self.fit, self.tracks = fit, tracks
        self.prepared = fit.prepare(tracks)
        self.predictor = fit.predictor()
        self.scaler = fit.preparation.scaler
        self.space = len(self.scaler.offset) // 2

    @cached_property
    def mean_path(self) -> torch.Tensor | None:
        """Mean of the posterior path, scaled, ``(trial, time, individual, state)``, NaN where
        nobody is; ``None`` for a model without states.
        """
        if not isinstance(self.predictor, StateSpacePredictor):
            return None
        with seeded(0), torch.no_grad():
            return self.predictor.mean_states(self.prepared)

    @cached_property
    def states(self) -> Array:
        """Positions and velocities that the model takes to have been, in the tracks' own units.

        ``(trial, time, individual, 2 * space)``, NaN where unknown; the observed ones if it smooths
        none.
        """
        path = self.mean_path
        if path is None or path.shape[-1] != 2 * self.space:
            return states_of(self.prepared.tracks)
        return self.scaler.inverse_tensor(path.to(torch.float64)).numpy()

    def latents(self) -> xr.DataArray:
        """Return the latents, see :func:`latents_of`."""
        if self.mean_path is not None:
            parts = self._state_space(self.mean_path)
        else:
            with torch.no_grad():
                mean = self.predictor.posterior(self.prepared, 0)[0].numpy()
            parts = [(mean, [f"z{place + 1}" for place in range(mean.shape[-1])], "latent")]
        source = self.prepared.tracks
        kinds = [kind for _, names, kind in parts for _ in names]
        return xr.DataArray(
            np.concatenate([values for values, _, _ in parts], -1).astype(np.float64),
            dims=(*DIMS, "latent"),
            coords={name: source[name].values for name in DIMS}
            | {
                "latent": [name for _, names, _ in parts for name in names],
                "kind": ("latent", kinds),
            },
            name="latents",
            attrs={"long_name": "posterior mean of the latents", "units": ""},
        )

    def _state_space(self, path: torch.Tensor) -> list[tuple[Array, list[str], str]]:
        """Return the states, and what the law of motion makes of them: values, names and kind."""
        model, fit = self.fit.model, self.fit
        assert isinstance(model, StateSpaceModel)
        present = path.isfinite().all(-1)
        gone = ~present.unsqueeze(-1)
        axes = list(SPACE_NAMES[: self.space])
        kinematic = model.state_dim == 2 * self.space
        if kinematic:
            own = self.states
            parts = [
                (own[..., : self.space], axes, "position"),
                (own[..., self.space :], [f"v{axis}" for axis in axes], "velocity"),
            ]
        else:
            names = [f"state {place + 1}" for place in range(model.state_dim)]
            parts = [(path.masked_fill(gone, torch.nan).numpy(), names, "state")]
        adjacency = graph_of_steps(fit, self.prepared)
        motion = acceleration_model(fit) if kinematic else None
        if motion is not None and motion.terms:
            still = torch.from_numpy(np.nan_to_num(self.states))
            with torch.no_grad():
                found = motion.forces(still, adjacency.to(torch.float64), present)
            found = found.transpose(-3, -2).flatten(-2).masked_fill(gone, torch.nan)
            names = [f"{term} {axis}" for term in motion.terms for axis in axes]
            parts.append((found.numpy(), names, "force"))
        parts += self._told_by(path.masked_fill(gone, 0.0), present)
        return parts

    def _told_by(
        self, scaled: torch.Tensor, present: torch.Tensor
    ) -> list[tuple[Array, list[str], str]]:
        """Return parts of the acceleration and features, of a transition that tells them."""
        model, guide = self.fit.model, self.fit.guide
        assert isinstance(model, StateSpaceModel)
        transition, gone = model.transition, ~present.unsqueeze(-1)
        axes = SPACE_NAMES[: self.space]
        values = guide.parameters_guide.median() if isinstance(guide, PathGuide) else {}
        graph = graph_of_steps(self.fit, self.prepared).to(scaled.dtype)
        given = step_inputs(model, graph, present)
        found = []
        with self.fit.with_parameters(values), torch.no_grad(), pyro.validation_enabled(False):
            given = model.edges.complete(scaled, given)
            if isinstance(transition, NamedParts):
                parts = transition.parts(scaled, given).transpose(-3, -2).flatten(-2)
                names = [f"{part} {axis}" for part in transition.part_names for axis in axes]
                found.append((parts, names, "part"))
            if isinstance(transition, NamedFeatures):
                told = transition.features(scaled, given)
                names = [str(name) for name in transition.feature_names]
                found.append((told, names, "message"))
        for told, names, _ in found:
            if len(names) != told.shape[-1]:
                raise InputError(
                    f"model: its transition tells {told.shape[-1]} numbers and has {len(names)} "
                    "names of them. Give each a name."
                )
        return [(told.masked_fill(gone, torch.nan).numpy(), n, kind) for told, n, kind in found]

    def forces(self) -> xr.DataArray:
        """Return the forces that latents are compared with, see :func:`forces_on`."""
        if "force" in self.tracks and {"term", "space"} <= set(self.tracks["force"].dims):
            true = with_trials(self.tracks)["force"].transpose(*DIMS, "term", "space")
            return true.astype(np.float64).assign_attrs(truth=1)
        source = self.prepared.tracks
        coords = {name: source[name].values for name in (*DIMS, "space")} | {"term": list(TERMS)}
        return xr.DataArray(
            self._terms(self.states), coords, (*DIMS, "term", "space"), attrs={"truth": 0}
        )

    def beside(self) -> dict[str, Array]:
        """Return simpler things to read forces from, ``(trial, time, individual, feature)``.

        ``acceleration`` (where the model has a law of motion), ``own observation``, ``own state``
        and ``observed terms``; see :func:`swarmssm.analysis.latent_force_alignment`.
        """
        found = {}
        acceleration = self._acceleration()
        if acceleration is not None:
            found["acceleration"] = acceleration
        whole = with_trials(self.prepared.tracks)
        position = whole["position"].transpose(*DIMS, "space").to_numpy()
        velocity = stepwise_velocity(position, whole.attrs["fps"])
        raw = np.concatenate([position, velocity], -1).astype(np.float64)
        found["own observation"] = raw
        found["own state"] = self._own_state()
        terms = self._terms(raw)
        found["observed terms"] = terms.reshape(*terms.shape[:3], -1)
        return found

    def _own_state(self) -> Array:
        """Return the truth of a simulation, else what the model takes the states to have been."""
        names = ("true_position", "true_velocity")
        if not all(name in self.tracks for name in names):
            return self.states
        whole = with_trials(self.tracks)
        parts = [whole[name].transpose(*DIMS, "space").to_numpy() for name in names]
        return np.concatenate(parts, -1).astype(np.float64)

    def _acceleration(self) -> Array | None:
        """Return what the model expects; ``None``, it has no law of motion."""
        try:
            motion = acceleration_model(self.fit)
        except InputError:
            return None
        states = torch.from_numpy(self.states)
        present = states.isfinite().all(-1)
        gone = ~present.unsqueeze(-1)
        graph = graph_of_steps(self.fit, self.prepared).to(torch.float64)
        with torch.no_grad():
            found = motion.acceleration(states.masked_fill(gone, 0.0), graph, present)
        return found.masked_fill(gone, torch.nan).numpy()

    def _terms(self, states: Array) -> Array:
        """Return (3.16)-(3.18) with gains of 1, ``(trial, time, individual, term, space)``."""
        moving = torch.from_numpy(states)
        known = moving.isfinite().all(-1)
        both = known.unsqueeze(-1) & known.unsqueeze(-2)
        graph = (self.prepared.adjacency & both).to(torch.float64)
        positions, velocities = moving[..., : self.space], moving[..., self.space :]
        terms = [
            forces.cohesion(positions, graph),
            forces.separation(positions, graph),
            forces.alignment(velocities, graph),
        ]
        return torch.stack(terms, dim=-2).masked_fill(~known[..., None, None], torch.nan).numpy()
