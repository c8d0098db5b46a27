"""A fitted model: its posterior, forecasts and free runs, with labels."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import xarray as xr

from swarmssm.errors import InputError, WorkError
from swarmssm.inference.convergence import Convergence, convergence
from swarmssm.inference.data import Prepared, prepare
from swarmssm.inference.guides import OneStepGuide
from swarmssm.inference.prediction import (
    InitialCondition,
    OneStepPredictor,
    Predictor,
    StateSpacePredictor,
    Trajectory,
    seeded,
)
from swarmssm.inference.run_folder import Run, load_run, save_run
from swarmssm.inference.starting import last_frames, most_complete_frames
from swarmssm.inference.summary import describe, page, posterior_table
from swarmssm.models import InferredEdges, OneStepModel, StateSpaceModel
from swarmssm.models.pyro_modules import own_parameters
from swarmssm.tracks import MAX_COORDINATE, Array, make_tracks, spatial_attributes
from swarmssm.tracks.splits import take

__all__ = ["Fit"]

EDGE_SOURCES = ("decoder", "rule")
#: Frames of history from which a state-space model is filtered at most.
HISTORY = 50


@dataclass(frozen=True, repr=False)
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

    @contextlib.contextmanager
    def with_parameters(self, values: Mapping[str, torch.Tensor]) -> Iterator[None]:
        """Let the model's parameters have given values for a while.

        Parameters
        ----------
        values
            Of those that have a prior, by full name, such as one draw of :meth:`parameters`; all
            others are as they were fitted.

        Raises
        ------
        InputError
            If there is no parameter of such a name with a prior, or the model is no
            :class:`~swarmssm.models.StateSpaceModel`.
        """
        if not isinstance(self.model, StateSpaceModel):
            raise InputError(f"model: {self.settings.model} has no parameters with a prior.")
        with own_parameters(self.model), self.model.fixed(values):
            yield

    def prepare(self, tracks: xr.Dataset) -> Prepared:
        """Return tracks as the model sees them; see :func:`swarmssm.inference.data.prepare`."""
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
        with seeded(seed):
            mean, sd, states = self.predictor().posterior(prepared, draws)
        dims = ("trial", "time", "individual", "latent")
        data: dict[str, Any] = {"mean": (dims, mean.numpy()), "sd": (dims, sd.numpy())}
        if states is not None:
            data["states"] = (("draw", *dims), states.numpy())
        return self._label(xr.Dataset(data), prepared.tracks)

    def edge_probabilities(self, tracks: xr.Dataset) -> xr.DataArray:
        """Return how probable each type of edge is for each pair, given all frames.

        Parameters
        ----------
        tracks
            Tracks.

        Returns
        -------
        ``(trial, time, individual, neighbor, edge_type)``: that the neighbor acts on the individual
        by an edge of this type, ``"none"`` being no edge. NaN where the two are not both there.
        Types that are fixed over a window are told by one window after the other, each as long as
        those of the fit (50 frames at most), which begin with the trial.

        Raises
        ------
        InputError
            If the edges of the fit are not inferred, or the tracks do not fit the model.
        """
        model = self.model
        if not isinstance(model, StateSpaceModel) or not isinstance(model.edges, InferredEdges):
            raise InputError(
                'edges: those of this run are not inferred; fit one with edges="relational" or '
                "dynamic-relational."
            )
        prepared = self.prepare(tracks)
        predictor = self.predictor()
        assert isinstance(predictor, StateSpacePredictor)
        found = predictor.edge_probabilities(prepared).numpy()
        dims = ("trial", "time", "individual", "neighbor", "edge_type")
        labelled = self._label(xr.Dataset({"edge_probability": (dims, found)}), prepared.tracks)
        probability = labelled["edge_probability"].assign_coords(edge_type=list(model.edges.names))
        probability.attrs = {"long_name": "probability of the type of edge", "units": "1"}
        return probability

    def parameters(self, draws: int = 1000, seed: int | torch.Generator = 0) -> xr.Dataset:
        """Draw the parameters of the model that have a prior from their posterior.

        Parameters
        ----------
        draws
            How many.
        seed
            Seed or generator.

        Returns
        -------
        Dataset with a variable ``(draw, ...)`` for each, by its full name such as
        ``transition.cohesion_gain``; empty if no parameter has a prior.

        Raises
        ------
        InputError
            If ``draws`` is not positive.
        """
        _check_count("draws", draws, 1)
        guide = getattr(self.guide, "parameters_guide", None)
        if guide is None:
            return xr.Dataset()
        with seeded(seed):
            drawn = guide.draw(draws)
        data = {}
        for name, value in drawn.items():
            short = name.rpartition(".")[2]
            dims = ["draw", *(f"{short}_dim_{i}" for i in range(value.dim() - 1))]
            data[name] = (dims, value.numpy())
        return xr.Dataset(data, {"draw": np.arange(draws)})

    def summary(
        self, draws: int = 4000, seed: int | torch.Generator = 0, entries: int = 8
    ) -> pd.DataFrame:
        """Summarise the posterior of the parameters that have a prior.

        Parameters
        ----------
        draws
            Number of draws behind each row.
        seed
            Seed or generator.
        entries
            Numbers of which a parameter may consist to have a row for each; a longer one, such as
            the spline coefficients of a kernel, is one row without numbers.

        Returns
        -------
        A row for each number, named by the parameter (and its place, for several), without the part
        of the model where that leaves no doubt; columns ``mean``, ``sd``, ``low`` and ``high``,
        these the ends of the central 90 % interval, ``unit`` (empty where it is not known), and
        ``note``: that a number is fixed, that its posterior is its prior, or that it is over four
        standard deviations of the prior away from it.
        """
        drawn = self.parameters(draws, seed)
        unit = str(self.provenance.get("data", {}).get("unit", ""))
        return posterior_table(self.model, drawn, unit, entries)

    @property
    def convergence(self) -> Convergence:
        """Whether the loss had come to rest when the fit ended."""
        return convergence(self.history)

    def __repr__(self) -> str:
        rows = describe(self).items()
        return "Fit\n" + "\n".join(f"    {name:<10}  {text}" for name, text in rows)

    def _repr_html_(self) -> str:
        return page(describe(self), self.summary())

    def predictive(
        self,
        tracks: xr.Dataset,
        draws: int = 0,
        seed: int | torch.Generator = 0,
    ) -> xr.Dataset:
        """Predict each frame from the frame before it.

        What the frame before knows of later ones, this knows too: velocities that were smoothed
        over the whole recording (``velocity="kalman"``) have seen the frame that is predicted.
        :func:`swarmssm.analysis.scoring.evaluate` smooths them from the past alone.

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
        predictor = self.predictor()
        results = []
        with seeded(seed):
            for _ in range(max(draws, 1)):
                states, edges = predictor.one_step(prepared, sample=bool(draws))
                results.append((_delayed(states), _delayed(edges)))
        states, edges = (torch.stack(column) for column in zip(*results, strict=True))
        if not draws:
            states, edges = states[0], edges[0]
        data = self._state_variables(states, ("draw",) * bool(draws))
        edge_dims = (*("draw",) * bool(draws), "trial", "time", "individual", "neighbor")
        data["edge_probability"] = (edge_dims, edges.numpy())
        return self._label(xr.Dataset(data), prepared.tracks)

    def predictor(self, edges: str = "decoder") -> Predictor:
        """Return what predicts, on tensors.

        Parameters
        ----------
        edges
            Where later graphs come from: ``"decoder"``, the model itself; ``"rule"``, the rule that
            made the graphs of the tracks, from the predicted states. A state-space model has no
            edges but those of its states: for it the two are one.

        Raises
        ------
        InputError
            If ``edges`` is unknown, or the rule.
        """
        if edges not in EDGE_SOURCES:
            raise InputError(
                f"edges: {edges!r} is unknown; choose one of {', '.join(EDGE_SOURCES)}."
            )
        scaler, rule = self.preparation.scaler, self.preparation.rule
        if isinstance(self.model, StateSpaceModel):
            window = self.settings.window
            window = min(window, HISTORY) if isinstance(window, int) else HISTORY
            return StateSpacePredictor(self.model, self.guide, scaler, rule, window)
        if isinstance(self.model, OneStepModel) and isinstance(self.guide, OneStepGuide):
            return OneStepPredictor(self.model, self.guide, scaler, rule, edges)
        raise InputError(
            f"model: {self.settings.model} with guide {self.settings.guide} cannot predict; it "
            "must be a StateSpaceModel, or a OneStepModel with a OneStepGuide."
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
            Where later graphs come from, see :meth:`predictor`.

        Returns
        -------
        Dataset with ``position`` and ``velocity`` ``([draw,] trial, time, space, individual)``,
        ``edge_probability ([draw,] trial, time, individual, neighbor)``, and ``time`` going on
        from the history. Each trial is continued from its last frame with anybody in it; who is
        just out of sight there is carried on, see ``extrapolate_missing``, who
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
        _, path = self._run_from(prepared, last, horizon, draws, seed, edges)
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
            Where the graphs come from, see :meth:`predictor`.

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
        fullest = most_complete_frames(prepared.mask)
        start, path = self._run_from(prepared, fullest, steps, draws, seed, edges)
        runs = max(draws, 1)
        states = path.states.reshape(runs, *path.states.shape[-4:]).to(torch.float64)
        states = self.preparation.scaler.inverse_tensor(states)
        first = start.unscaled.reshape(runs, *start.unscaled.shape[-3:]).unsqueeze(2)
        whole = torch.cat([first, states], dim=2).numpy()
        # Only who was absent from the start may be unknown: what is not a number has diverged too.
        present = start.present.reshape(runs, *start.present.shape[-2:])[:, :, None, :, None]
        seen = np.broadcast_to(present.numpy(), whole.shape)
        if not (np.abs(whole[seen]) <= MAX_COORDINATE).all():
            raise WorkError("rollout: the free run left all bounds; take fewer steps.")
        graph = path.adjacency.reshape(runs, *path.adjacency.shape[-4:])
        first = start.adjacency.bool().reshape(runs, *start.adjacency.shape[-3:]).unsqueeze(2)
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
            source_software="swarmssm",
            attrs={"free_run_of": self.settings.model, **spatial_attributes(source)},
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
        prepared: Prepared,
        rows: torch.Tensor,
        steps: int,
        draws: int,
        seed: int | torch.Generator,
        edges: str,
    ) -> tuple[InitialCondition, Trajectory]:
        """Run from one row of each trial."""
        predictor = self.predictor(edges)
        trials = torch.arange(len(rows))
        with seeded(seed):
            beginning = predictor.begin(prepared, trials, rows, draws, carry=True)
            return beginning, predictor.run(beginning, steps, sample=bool(draws))

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
