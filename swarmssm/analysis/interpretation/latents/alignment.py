"""Which latent carries which force: probes of what a model has learned, with how sure."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from swarmssm.analysis.interpretation.latents.block_folds import Cells, Folds
from swarmssm.analysis.interpretation.latents.probes import RidgeProbe, curved
from swarmssm.analysis.interpretation.latents.rotations import RotatedAxes, rotated_axes
from swarmssm.analysis.interpretation.latents.samples import Samples, Scores, scaled
from swarmssm.analysis.interpretation.latents.sources import View, latents_of, untrained
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["compare_latents", "latent_force_alignment"]

PROBES = ("linear", "kernel")
#: Places of the Gaussian bumps of a kernel probe, of all latents and of a single one.
LANDMARKS, FEW_LANDMARKS = 60, 6
#: Principal components, and frames to learn from, at which probes are compared.
COMPONENTS = (1, 2, 4, 6, 8, 12, 16, 24, 32)
FRAMES = (10, 20, 50, 100, 200, 500, 1000)
GROUPS = {
    "state": ("position", "velocity", "state"),
    "forces": ("force",),
    "parts": ("part",),
    "messages": ("message",),
}


def latent_force_alignment(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    folds: int = 5,
    shifts: int = 199,
    untrained_seeds: int = 3,
    limit: int = 20_000,
    seed: int = 0,
) -> xr.Dataset:
    """Say how well each latent of a fitted model, and all of them, tell each force.

    See :func:`compare_latents` for what is computed. Latents and forces are those of
    :func:`~swarmssm.analysis.interpretation.latents.sources.latents_of` and
    ``forces_on``. The same probes are given, on the same
    frames:

    * the latents by their kinds: the states, the forces, the parts of the acceleration or the
      messages alone;
    * the ``acceleration`` that the model expects, 2 or 3 numbers: all that it makes of the latents;
    * the latents of the same model and guide before training, with several random initialisations;
    * ``own observation``: one's own position and its finite difference, and ``own state``: one's
      own state, true where it is known and else smoothed. What these tell needs no neighbours;
    * ``observed terms``: (3.16)-(3.18) of the raw observations, that need no model.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or better others. With the variable ``force``, as simulated
        ones have it, latents are compared with the true forces.
    folds
        Of the cross-validation, at least 3.
    shifts
        Random shifts behind each p-value.
    untrained_seeds
        Initialisations of the untrained model; 0 for none.
    limit
        Frames are thinned out until there are so few states of individuals.
    seed
        Of shifts and of the places of kernels.

    Returns
    -------
    Labelled dataset, see :func:`compare_latents`.

    Raises
    ------
    InputError
        If the model cannot predict, the tracks do not fit it, or they are too short.
    """
    view = View(fit, tracks)
    latents, force, others = view.latents(), view.forces(), view.beside()
    fresh = untrained(fit, range(seed, seed + untrained_seeds))
    before = [latents_of(one, tracks) for one in fresh]
    return compare_latents(
        latents,
        force,
        others,
        before,
        fps=float(tracks.attrs["fps"]),
        folds=folds,
        shifts=shifts,
        limit=limit,
        seed=seed,
    ).assign_attrs(model=fit.settings.model, guide=fit.settings.guide)


def compare_latents(
    latents: xr.DataArray,
    force: xr.DataArray,
    others: Mapping[str, Array] | None = None,
    before: Sequence[xr.DataArray] = (),
    *,
    fps: float,
    folds: int = 5,
    shifts: int = 199,
    limit: int = 20_000,
    seed: int = 0,
) -> xr.Dataset:
    r"""Say how well latents tell forces, on frames that the probes were not fitted on.

    All :math:`R^2` are of frames left out: whole trials where there are three or more, else
    blocks of time with a gap as long as forces remember themselves
    (``block_folds``). The ``linear`` probe is a ridge
    regression, ``kernel`` a small kernel ridge regression
    (``curved``), the penalties chosen within the training
    part. p-values are shares of random shifts of the forces of the whole swarm in time, and
    between trials, that do at least as well
    (:class:`~swarmssm.analysis.interpretation.latents.time_shifts.Shifts`).

    Parameters
    ----------
    latents
        ``(trial, time, individual, latent)`` with the coordinate ``kind``.
    force
        ``(trial, time, individual, term, space)``.
    others
        Further things to read forces from, ``(trial, time, individual, feature)``.
    before
        The latents of the untrained model, one for each initialisation.
    fps
        Frames per second.
    folds, shifts, limit, seed
        As in :func:`latent_force_alignment`.

    Returns
    -------
    Dataset with

    ``latent_r2``, ``latent_p``, ``latent_family_p (latent, probe, term, space)``
        Of each latent by itself and each component of each force. ``latent_family_p`` is the share
        of shifts in which the best of all latents and components did as well: it holds for all of
        the table at once.
    ``latent_vector_r2``, ``latent_vector_p (latent, probe, term)``
        The same of forces as vectors.
    ``source_r2 (source, probe, term, space)``, ``source_vector_r2``, ``source_p (source, probe,
    term)``
        Of all latents together (source ``latents``), of each kind, and of the others.
    ``untrained_r2 (initialization, source, probe, term)``
        ``source_vector_r2`` of the untrained model, NaN for what is not trained.
    ``canonical_correlation``, ``canonical_p (source, canonical)``
        Between each source and all forces together.
    ``direction (group, axis, latent)``
        Directions in the space of all latents, or those of a kind, each divided by
        ``latent_scale``, one for each component of a force: those of its regression, and where
        there are enough dimensions (``orthogonal``), brought to right angles with each other.
    ``axis_r2 (group, axis, component)``, ``purity (group, axis)``
        How well each of these axes alone tells each component, and its own one as a share of what
        all of the group tell of it, between 0 and 1
        (:class:`~swarmssm.analysis.interpretation.latents.rotations.RotatedAxes`).
    ``component_r2 (training, components, term)``, ``frame_r2 (training, frames, term)``
        The linear probe of so many principal components, and learned from so many frames; trained
        and untrained (the median over initialisations).

    Raises
    ------
    InputError
        If there are too few frames, or latents and forces have none in common.
    """
    # Many small matrices: threads that wait for each other would cost more than they save.
    with threadpool_limits(limits=1, user_api="blas"):
        return _compared(
            latents, force, dict(others or {}), before, fps, folds, shifts, limit, seed
        )


def _compared(
    latents: xr.DataArray,
    force: xr.DataArray,
    others: dict[str, Array],
    before: Sequence[xr.DataArray],
    fps: float,
    folds: int,
    shifts: int,
    limit: int,
    seed: int,
) -> xr.Dataset:
    """Do what :func:`compare_latents` says."""
    groups = _groups(latents)
    arrays = {name: latents.to_numpy()[..., chosen] for name, chosen in groups.items()}
    arrays |= others
    target = force.transpose("trial", "time", "individual", "term", "space").to_numpy()
    number, shape = target.shape[3], target.shape[3:]
    flat = target.reshape(*target.shape[:3], -1)
    own = [one.to_numpy() for one in before]
    known = np.logical_and.reduce([np.isfinite(a).all(-1) for a in [*arrays.values(), *own, flat]])
    data = Samples.of(known, flat, shape, fps, folds, shifts, limit, seed)

    sources: dict[str, list[Scores]] = {}
    canonical: dict[str, tuple[Array, Array]] = {}
    for name, values in arrays.items():
        rows = data.rows(values)
        bumps = curved(rows, LANDMARKS, seed)[None]
        sources[name] = [data.score(rows[None], linear=True), data.score(bumps, linear=False)]
        canonical[name] = data.canonical(rows)
    fresh = np.full((len(own), len(arrays), len(PROBES), number), np.nan)
    for place, one in enumerate(own):
        for group, chosen in enumerate(groups.values()):
            rows = data.rows(one[..., chosen])
            bumps = curved(rows, LANDMARKS, seed)
            for probe, (features, linear) in enumerate(((rows, True), (bumps, False))):
                scores = data.probe(features, linear=linear).r2(data.targets)
                fresh[place, group, probe] = scores[1][0]

    rows = data.rows(arrays["latents"])
    each = rows.T[..., None]
    bumps = _stacked([curved(column, FEW_LANDMARKS, seed) for column in each])
    single = [data.score(each, linear=True), data.score(bumps, linear=False)]
    kinds = latents["kind"].values.astype(str)
    axes = {
        name: rotated_axes(
            rows[:, chosen],
            data.flat_targets,
            data.cells,
            sources[name][0].each[0].reshape(-1),
        )
        for name, chosen in groups.items()
    }
    out = _dataset(single, sources, canonical, fresh)
    out = out.assign(_curves(data, rows, [data.rows(one) for one in own]))
    out = out.assign(_rotations(axes, groups, len(kinds)))
    out = out.assign(source_size=("source", [values.shape[-1] for values in arrays.values()]))
    labels = [f"{t} {s}" for t in force["term"].values for s in force["space"].values]
    out = out.assign_coords(
        latent=latents["latent"].values,
        kind=("latent", kinds),
        source=list(arrays),
        group=list(groups),
        probe=list(PROBES),
        term=force["term"].values,
        space=force["space"].values,
        axis=labels,
        component=labels,
    )
    out.attrs = {
        "truth": int(force.attrs.get("truth", 0)),
        "folds": len(data.folds),
        "folds_by": data.folds.by,
        "gap_seconds": data.folds.gap * data.stride / fps,
        "shifts": len(data.shifts),
        "least_p": data.shifts.least_p,
        "samples": len(data.targets),
        "frames": int(np.unique(data.frames).size),
        "initializations": len(own),
    }
    return _described(out)


def _groups(latents: xr.DataArray) -> dict[str, npt.NDArray[np.int64]]:
    """Return the latents all together, and where there are several kinds, each of them."""
    kinds = latents["kind"].values.astype(str)
    groups = {"latents": np.arange(len(kinds))}
    parts = {name: np.flatnonzero(np.isin(kinds, members)) for name, members in GROUPS.items()}
    parts = {name: chosen for name, chosen in parts.items() if len(chosen)}
    return groups | parts if len(parts) > 1 else groups


def _stacked(features: list[Array]) -> Array:
    """Stack features of each latent; those with fewer landmarks get columns that do not vary."""
    width = max(one.shape[1] for one in features)
    return np.stack([np.pad(one, ((0, 0), (0, width - one.shape[1]))) for one in features])


def _curves(data: Samples, rows: Array, before: list[Array]) -> xr.Dataset:
    """Return how R^2 grows with the number of components, and of frames to learn from."""
    components = [n for n in COMPONENTS if n < rows.shape[1]] + [rows.shape[1]]
    trained = int(data.folds.train.sum((1, 2)).min())
    frames = [n for n in FRAMES if n < trained] + [trained]
    number = data.targets.shape[1]
    by_component = np.full((2, len(components), number), np.nan)
    by_frame = np.full((2, len(frames), number), np.nan)
    for place, given in enumerate(([rows], before)):
        found = [_one_curve(data, one, components, frames) for one in given]
        if found:
            by_component[place] = np.median([one for one, _ in found], 0)
            by_frame[place] = np.median([other for _, other in found], 0)
    return xr.Dataset(
        {
            "component_r2": (("training", "components", "term"), by_component),
            "frame_r2": (("training", "frames", "term"), by_frame),
        },
        {"training": ["trained", "untrained"], "components": components, "frames": frames},
    )


def _rotations(
    axes: dict[str, RotatedAxes], groups: dict[str, npt.NDArray[np.int64]], count: int
) -> xr.Dataset:
    """Put the rotations of all groups into one dataset; 0 for a latent outside the group."""
    number = next(iter(axes.values())).direction.shape[0]
    direction = np.zeros((len(axes), number, count))
    scale = np.full((len(axes), count), np.nan)
    for place, (name, chosen) in enumerate(groups.items()):
        direction[place][:, chosen] = axes[name].direction
        scale[place, chosen] = axes[name].scale
    found = list(axes.values())
    return xr.Dataset(
        {
            "direction": (("group", "axis", "latent"), direction),
            "latent_scale": (("group", "latent"), scale),
            "axis_r2": (("group", "axis", "component"), np.stack([one.r2 for one in found])),
            "purity": (("group", "axis"), np.stack([one.purity for one in found])),
            "orthogonal": ("group", [int(one.orthogonal) for one in found]),
        }
    )


def _one_curve(
    data: Samples, rows: Array, components: list[int], frames: list[int]
) -> tuple[Array, Array]:
    """Return the two curves of one set of latents, ``(place, term)``."""
    unit = scaled(rows)
    _, basis = np.linalg.eigh(unit.T @ unit)
    turned = unit @ basis[:, ::-1]
    one = [data.probe(turned[:, :n], linear=False).r2(data.targets)[1][0] for n in components]
    other = []
    for count in frames:
        train = np.zeros_like(data.folds.train)
        for fold, whole in enumerate(data.folds.train):
            places = np.flatnonzero(whole)
            few = places[np.linspace(0, len(places) - 1, count).astype(int)]
            train[fold].flat[few] = True
        folds = Folds(train, data.folds.test, data.folds.by, data.folds.gap)
        probe = RidgeProbe(unit, Cells.of(data.frames, folds))
        other.append(probe.r2(data.targets)[1][0])
    return np.stack(one), np.stack(other)


def _dataset(
    single: list[Scores],
    sources: dict[str, list[Scores]],
    canonical: dict[str, tuple[Array, Array]],
    fresh: Array,
) -> xr.Dataset:
    """Put scores into one dataset."""

    def over_latents(name: str) -> Array:
        return np.stack([getattr(scores, name) for scores in single], axis=1)

    def over_sources(name: str) -> Array:
        rows = [np.stack([getattr(s, name)[0] for s in scores]) for scores in sources.values()]
        return np.stack(rows)

    most = max(len(found) for found, _ in canonical.values())
    pairs = np.full((2, len(canonical), most), np.nan)
    for place, both in enumerate(canonical.values()):
        for row, values in enumerate(both):
            pairs[row, place, : len(values)] = values
    components = ("latent", "probe", "term", "space")
    vectors = ("latent", "probe", "term")
    return xr.Dataset(
        {
            "latent_r2": (components, over_latents("each")),
            "latent_p": (components, over_latents("each_p")),
            "latent_family_p": (components, over_latents("family_p")),
            "latent_vector_r2": (vectors, over_latents("vector")),
            "latent_vector_p": (vectors, over_latents("vector_p")),
            "source_r2": (("source", "probe", "term", "space"), over_sources("each")),
            "source_vector_r2": (("source", "probe", "term"), over_sources("vector")),
            "source_p": (("source", "probe", "term"), over_sources("vector_p")),
            "untrained_r2": (("initialization", "source", "probe", "term"), fresh),
            "canonical_correlation": (("source", "canonical"), pairs[0]),
            "canonical_p": (("source", "canonical"), pairs[1]),
        },
        {"canonical": np.arange(1, most + 1)},
    )


def _described(dataset: xr.Dataset) -> xr.Dataset:
    """Say of each variable what it is."""
    names = {
        "latent_r2": "cross-validated R^2 of a component of a force from one latent",
        "latent_p": "p-value of it by shifts in time",
        "latent_family_p": "p-value of it that holds for all latents and components at once",
        "latent_vector_r2": "cross-validated R^2 of a force from one latent",
        "latent_vector_p": "p-value of it by shifts in time",
        "source_r2": "cross-validated R^2 of a component of a force",
        "source_vector_r2": "cross-validated R^2 of a force",
        "source_p": "p-value of it by shifts in time",
        "source_size": "number of features",
        "untrained_r2": "cross-validated R^2 of a force from the untrained model",
        "canonical_correlation": "cross-validated canonical correlation with all forces",
        "canonical_p": "p-value of it by shifts in time",
        "component_r2": "cross-validated R^2 of a force from principal components",
        "frame_r2": "cross-validated R^2 of a force with few frames to learn from",
        "orthogonal": "1 if the rotated axes are at right angles",
        "direction": "direction of a rotated axis in the scaled latents",
        "latent_scale": "by which a latent is divided before it is rotated",
        "axis_r2": "cross-validated R^2 of a component of a force from one rotated axis",
        "purity": "share of what all latents tell of a component that its own axis tells",
    }
    for name, text in names.items():
        dataset[name].attrs = {"long_name": text, "units": "1"}
    return dataset
