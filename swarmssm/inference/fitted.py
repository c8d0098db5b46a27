"""A fitted model: its posterior, forecasts and free runs, with labels."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xarray as xr

from swarmssm.errors import InputError, WorkError
from swarmssm.inference.data import Prepared, prepare
from swarmssm.inference.forecasting import Stepper, Trajectory, seeded
from swarmssm.inference.run_folder import Run, load_run, save_run
from swarmssm.inference.starting import Start, fullest_frames, last_frames, start_at
from swarmssm.splits import take
from swarmssm.tracks import MAX_COORDINATE, Array, make_tracks

__all__ = ["Fit"]

#: Elements of the largest tensor of one chunk of frames, so that memory stays bounded.
CHUNK = 20_000_000


@dataclass(frozen=True)
class Fit(Run):
    """What :func:`swarmssm.inference.fit` returns: a model with its posterior.

    See :class:`swarmssm.inference.run_folder.Run` for its attributes.
    """

    @property
    def num_parameters(self) -> int:
        """Number of learned weights, of model and guide together."""
        modules = (self.model, self.guide)
        return sum(p.numel() for module in modules for p in module.parameters())

    def part(self, tracks: xr.Dataset, name: str) -> xr.Dataset:
        """Return ``"train"``, ``"validation"`` or ``"test"`` of the tracks the model was fitted on.

        Raises
        ------
        InputError
            If the part is empty, or the tracks are not those.
        """
        segments = self.split.part(name)
        if not segments:
            raise InputError(f"part: the {name} part is empty; fit with other fractions.")
        return take(tracks, segments)

    def prepare(self, tracks: xr.Dataset) -> Prepared:
        """Return tracks as the model sees them."""
        return prepare(tracks, self.preparation)

    def posterior(
        self, tracks: xr.Dataset, draws: int = 100, seed: int | torch.Generator = 0
    ) -> xr.Dataset:
        """Draw latent states of every frame from the guide.

        Parameters
        ----------
        tracks
            Tracks.
        draws
            How many; 0 for moments only.
        seed
            Seed or generator.

        Returns
        -------
        Dataset with ``mean`` and ``sd`` ``(trial, time, individual, latent)`` and, if there are
        draws, ``states`` ``(draw, trial, time, individual, latent)``; NaN where not observed.

        Raises
        ------
        InputError
            If ``draws`` is negative, or the tracks do not fit the model.
        """
        _check_count("draws", draws, 0)
        prepared = self.prepare(tracks)
        hidden = ~prepared.mask.unsqueeze(-1)

        def encode(observations: torch.Tensor, adjacency: torch.Tensor) -> tuple[torch.Tensor, ...]:
            posterior = self.guide.encode(observations, adjacency)
            return posterior.mean, posterior.stddev

        mean, sd = self._by_chunks(prepared, encode)
        dims = ("trial", "time", "individual", "latent")
        data: dict[str, Any] = {
            "mean": (dims, mean.masked_fill(hidden, torch.nan).numpy()),
            "sd": (dims, sd.masked_fill(hidden, torch.nan).numpy()),
        }
        if draws:
            with seeded(seed):
                noise = torch.randn(draws, *mean.shape)
            states = (mean + sd * noise).masked_fill(hidden, torch.nan)
            data["states"] = (("draw", *dims), states.numpy())
        return self._label(xr.Dataset(data), prepared.tracks)

    def predictive(
        self,
        tracks: xr.Dataset,
        draws: int = 0,
        seed: int | torch.Generator = 0,
    ) -> xr.Dataset:
        """Predict each frame from the frame before it.

        What the frame before knows of later ones, this knows too: velocities that were smoothed
        over the whole recording (``velocity="kalman"``) have seen the frame that is predicted.
        :func:`swarmssm.analysis.evaluate` smooths them from the past alone.

        Parameters
        ----------
        tracks
            Tracks.
        draws
            Draws of the posterior predictive; 0 for the prediction at the posterior mean.
        seed
            Seed or generator.

        Returns
        -------
        Dataset with ``position`` and ``velocity`` ``([draw,] trial, time, space, individual)`` in
        the tracks' units and ``edge_probability ([draw,] trial, time, individual, neighbor)``; the
        first frame of a trial, and whatever follows a frame in which an individual was not
        observed, is NaN.

        Raises
        ------
        InputError
            If ``draws`` is negative, or the tracks do not fit the model.
        """
        _check_count("draws", draws, 0)
        prepared = self.prepare(tracks)
        absent = ~prepared.mask

        def step(observations: torch.Tensor, adjacency: torch.Tensor) -> tuple[torch.Tensor, ...]:
            posterior = self.guide.encode(observations, adjacency)
            following = self.model.decode(posterior.sample() if draws else posterior.mean)
            states = following.states.sample() if draws else following.states.mean
            return states, following.edge_logits.sigmoid()

        results = []
        with seeded(seed):
            for _ in range(max(draws, 1)):
                states, edges = self._by_chunks(prepared, step)
                states = states.masked_fill(absent.unsqueeze(-1), torch.nan)
                alone = absent.unsqueeze(-1) | absent.unsqueeze(-2)
                edges = edges.masked_fill(alone, torch.nan)
                results.append((_delayed(states), _delayed(edges)))
        states, edges = (torch.stack(column) for column in zip(*results, strict=True))
        if not draws:
            states, edges = states[0], edges[0]
        data = self._state_variables(states, ("draw",) * bool(draws))
        edge_dims = (*("draw",) * bool(draws), "trial", "time", "individual", "neighbor")
        data["edge_probability"] = (edge_dims, edges.numpy())
        return self._label(xr.Dataset(data), prepared.tracks)

    def stepper(self, edges: str = "decoder") -> Stepper:
        """Return the one-step rule on tensors, see :class:`Stepper`."""
        return Stepper(
            self.model, self.guide, self.preparation.scaler, self.preparation.rule, edges
        )

    def forecast(
        self,
        history: xr.Dataset,
        horizon: int,
        draws: int = 100,
        seed: int | torch.Generator = 0,
        edges: str = "decoder",
    ) -> xr.Dataset:
        """Draw what may come after the last frame of the history, which is all it knows.

        Parameters
        ----------
        history
            Tracks, at least two frames.
        horizon
            Number of steps ahead.
        draws
            Number of sampled futures; 0 for the one in which everything takes its mean.
        seed
            Seed or generator.
        edges
            Where later graphs come from, see :class:`Stepper`.

        Returns
        -------
        Dataset with ``position`` and ``velocity`` ``([draw,] trial, time, space, individual)``,
        ``edge_probability ([draw,] trial, time, individual, neighbor)``, and ``time`` going on
        from the history. Each trial is continued from its last frame with anybody in it; who is
        just out of sight there is carried on, see :func:`swarmssm.inference.starting.start_at`, who
        has been so for longer stays NaN.

        Raises
        ------
        InputError
            If ``horizon`` is not positive, ``draws`` is negative, ``edges`` is unknown, or the
            tracks do not fit the model.
        """
        _check_count("horizon", horizon, 1)
        _check_count("draws", draws, 0)
        prepared = self.prepare(history)
        last = last_frames(prepared.mask)
        start = start_at(prepared, self.preparation, last)
        path = self._run_from(start, horizon, draws, seed, edges)
        leading = ("draw",) * bool(draws)
        data = self._state_variables(path.states, leading)
        edge_dims = (*leading, "trial", "time", "individual", "neighbor")
        data["edge_probability"] = (edge_dims, path.edge_probability.numpy())
        source = prepared.tracks
        stamps = source["time"].to_numpy()
        step = 1.0 / source.attrs["fps"]
        ends = stamps[last.numpy()]
        common = len(set(ends.tolist())) == 1
        ahead = np.arange(1, horizon + 1) * step
        out = self._label(xr.Dataset(data), source.drop_vars("time", errors="ignore"))
        out = out.assign_coords(time=(ends[0] if common else 0.0) + ahead)
        out = out.assign_coords(history_end=("trial", ends))
        out.attrs["horizon"] = horizon
        return out

    def rollout(
        self,
        initial: xr.Dataset,
        steps: int,
        draws: int = 1,
        seed: int | torch.Generator = 0,
        edges: str = "decoder",
    ) -> xr.Dataset:
        """Let the learned rule run freely from the last full frame of ``initial``.

        Parameters
        ----------
        initial
            Tracks; each trial is started from its last frame in which most individuals are seen.
        steps
            Number of steps.
        draws
            Number of sampled runs from each start; 0 for the run without noise.
        seed
            Seed or generator.
        edges
            Where the graphs come from, see :class:`Stepper`.

        Returns
        -------
        Tracks of ``steps + 1`` frames, the first being the start; each run is a trial, named
        ``<trial>`` or, with several draws, ``<trial>/<draw>``. Individuals absent at the start
        stay absent.

        Raises
        ------
        InputError
            If ``steps`` is not positive, ``draws`` is negative, ``edges`` is unknown, or the
            tracks do not fit the model.
        WorkError
            If the run leaves all bounds.
        """
        _check_count("steps", steps, 1)
        _check_count("draws", draws, 0)
        prepared = self.prepare(initial)
        start = start_at(prepared, self.preparation, fullest_frames(prepared.mask))
        path = self._run_from(start, steps, draws, seed, edges)
        runs = max(draws, 1)
        states = path.states.reshape(runs, *path.states.shape[-4:]).to(torch.float64)
        states = self.preparation.scaler.inverse_tensor(states)
        first = start.unscaled.expand(runs, *start.unscaled.shape).unsqueeze(2)
        whole = torch.cat([first, states], dim=2).numpy()
        # Only who was absent from the start may be unknown: what is not a number has diverged too.
        seen = np.broadcast_to(start.present.numpy()[None, :, None, :, None], whole.shape)
        if not (np.abs(whole[seen]) <= MAX_COORDINATE).all():
            raise WorkError("rollout: the free run left all bounds; take fewer steps.")
        graph = path.adjacency.reshape(runs, *path.adjacency.shape[-4:])
        first = start.adjacency.bool().expand(runs, -1, -1, -1).unsqueeze(2)
        graph = torch.cat([first, graph], dim=2)
        flat = whole.reshape(-1, *whole.shape[2:])
        half = flat.shape[-1] // 2
        names = [str(name) for name in prepared.tracks["trial"].values]
        labels = [name if runs == 1 else f"{name}/{run}" for run in range(runs) for name in names]
        source = prepared.tracks
        return make_tracks(
            flat[..., :half],
            velocity=flat[..., half:],
            adjacency=graph.reshape(-1, *graph.shape[2:]).numpy(),
            fps=source.attrs["fps"],
            individuals=[str(name) for name in source["individual"].values],
            trials=labels,
            unit=source.attrs.get("unit", ""),
            source_software="swarmssm",
            attrs={"free_run_of": self.settings.model},
        )

    def save(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write a run folder, see :mod:`swarmssm.inference.run_folder`."""
        save_run(self, Path(folder), overwrite=overwrite)

    @classmethod
    def load(cls, folder: str | Path, *, trust_code: bool = False) -> "Fit":
        """Read a run folder, see :func:`swarmssm.inference.run_folder.load_run`."""
        return cls(**vars(load_run(Path(folder), trust_code=trust_code)))

    def _run_from(
        self,
        start: Start,
        steps: int,
        draws: int,
        seed: int | torch.Generator,
        edges: str,
    ) -> Trajectory:
        """Run from a start."""
        shape = (draws,) * bool(draws)
        states, adjacency, present = (
            value.expand(*shape, *value.shape)
            for value in (start.states, start.adjacency, start.present)
        )
        with seeded(seed):
            return self.stepper(edges).run(states, adjacency, present, steps, sample=bool(draws))

    def _by_chunks(
        self,
        prepared: Prepared,
        function: Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, ...]],
    ) -> tuple[torch.Tensor, ...]:
        """Apply a function of frames to all frames, a bounded number at once."""
        observations = prepared.observations.flatten(0, 1)
        adjacency = prepared.adjacency.flatten(0, 1)
        size = max(1, CHUNK // max(1, adjacency.shape[-1] ** 2))
        with torch.no_grad():
            pieces = [
                function(x, a.to(torch.float32))
                for x, a in zip(
                    torch.split(observations, size), torch.split(adjacency, size), strict=True
                )
            ]
        shape = prepared.mask.shape[:2]
        columns = zip(*pieces, strict=True)
        return tuple(torch.unflatten(torch.cat(column), 0, shape) for column in columns)

    def _state_variables(self, states: torch.Tensor, leading: tuple[str, ...]) -> dict[str, Any]:
        """Return positions and velocities in the tracks' units, in the order of their schema."""
        values: Array = self.preparation.scaler.inverse(states.numpy().astype(np.float64))
        half = values.shape[-1] // 2
        dims = (*leading, "trial", "time", "space", "individual")
        return {
            name: (dims, np.ascontiguousarray(np.swapaxes(part, -1, -2)))
            for name, part in (("position", values[..., :half]), ("velocity", values[..., half:]))
        }

    def _label(self, dataset: xr.Dataset, source: xr.Dataset) -> xr.Dataset:
        """Give a dataset the coordinates and attributes of the tracks it came from."""
        coords = {
            name: source[name]
            for name in ("trial", "time", "space", "individual", "neighbor")
            if name in dataset.dims and name in source.coords
        }
        if "draw" in dataset.dims:
            dataset = dataset.assign_coords(draw=np.arange(dataset.sizes["draw"]))
        if "latent" in dataset.dims:
            dataset = dataset.assign_coords(latent=np.arange(dataset.sizes["latent"]))
        dataset = dataset.assign_coords(coords)
        dataset.attrs = {key: source.attrs[key] for key in ("fps", "time_unit", "unit")}
        return dataset


def _delayed(values: torch.Tensor) -> torch.Tensor:
    """Shift a prediction to the frame it is of: along dimension 1, the first frame NaN."""
    return torch.cat([torch.full_like(values[:, :1], torch.nan), values[:, :-1]], dim=1)


def _check_count(name: str, value: int, least: int) -> None:
    """Refuse a count that is too small."""
    if value < least:
        raise InputError(f"{name}: it must be at least {least}, and it is {value}.")
