"""Cut the bundled clip of sunbleak out of a longer recording of the same shoal.

    python benchmarks/make_sunbleak_clip.py SOURCE.npz swarmssm/data/sunbleak.npz

SOURCE holds ``xy`` (time, individual, 2) of all identities, NaN = not tracked, with ``frame``,
``time_s``, ``id`` and ``fps``. What is done, in this order:

1. The frames 1200 to 1399 are kept: five seconds, in which many fish are tracked without a gap and
   neighbours stay neighbours. In longer windows they part, and fewer are tracked throughout.
2. Runs of fewer than five frames are dropped: a tracker that has lost a fish tries it on a
   neighbour for a frame every now and then.
3. The fish tracked in at least 90 % of the frames are kept.
4. They are put in an order such that the first N are a group whose members are, as far as N
   allows, each other's nearest neighbours throughout (see ``group_order``). The first 30 never come
   within 10 units (25 cm) of a wall, so that what moves them is mostly each other.
5. Positions are rounded to 1/1024 of a unit, less than a hundredth of a frame's way.

No identity swap had to be cut: no fish that is kept moves farther than five times the median step.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.spatial

from swarmssm.files import check_output, write_beside
from swarmssm.tracks import Array

FRAMES = (1200, 1400)
MIN_RUN = 5
MIN_PRESENCE = 0.9
NUM_NEIGHBORS = 6
CORE = 30
WALLS = ((3.0, 119.0), (3.0, 122.0))
MIN_WALL_DISTANCE = 10.0
GRID = 1024

ABOUT = {
    "unit": "TRex cm",
    "scale": "not calibrated: the tank is 3 m wide and spans about 119 units, some 2.5 cm each",
    "species": "Leucaspius delineatus (sunbleak)",
    "source": "reversals3m_1024_dotbot_20181025_105202.stitched, TRex X#wcentroid, Y#wcentroid",
    "license": "CC BY 4.0, https://creativecommons.org/licenses/by/4.0/",
    "attribution": (
        "Walter, T., Albi, A., Bath, D., Couzin, I. D. et al. (2020). Reproduction Data for: TRex. "
        "https://doi.org/10.17617/3.4y; paper: https://doi.org/10.7554/eLife.64000"
    ),
}
CHANGES = (
    "Stacked into one array; cut to frames {first}-{last} and to the {kept} of {all} identities "
    "tracked in at least {presence:.0%} of them; runs shorter than {run} frames dropped; "
    "individuals reordered; positions rounded to 1/{grid} unit."
)

Counts = npt.NDArray[np.int64]


def tracked(positions: Array) -> npt.NDArray[np.bool_]:
    """Return where both coordinates of ``(..., 2)`` are known."""
    return np.asarray(np.isfinite(positions).all(axis=-1))


def drop_short_runs(positions: Array, shortest: int) -> Array:
    """Return positions ``(time, individual, 2)`` without runs shorter than ``shortest`` frames."""
    kept = positions.copy()
    present = tracked(positions)
    for member in range(positions.shape[1]):
        padded = np.concatenate([[0], present[:, member].astype(np.int8), [0]])
        starts, stops = (np.flatnonzero(np.diff(padded) == sign) for sign in (1, -1))
        for start, stop in zip(starts, stops, strict=True):
            if stop - start < shortest:
                kept[start:stop, member] = np.nan
    return kept


def neighbor_counts(everyone: Array, present: npt.NDArray[np.bool_], number: int) -> Counts:
    """Count in how many frames j is among the nearest ``number`` of i, out of everyone seen.

    Parameters
    ----------
    everyone
        Positions of all identities, shape ``(time, individual, 2)``.
    present
        Frames that count for i, shape ``(time, individual)``.
    number
        How many nearest neighbours.

    Returns
    -------
    Shape ``(individual, neighbor)``.
    """
    num_individuals = everyone.shape[1]
    counts = np.zeros((num_individuals, num_individuals), dtype=np.int64)
    for frame, counted in zip(everyone, present, strict=True):
        seen = np.flatnonzero(tracked(frame))
        order = np.asarray(scipy.spatial.cKDTree(frame[seen]).query(frame[seen], k=number + 1)[1])
        for member, nearest in zip(seen, order, strict=True):
            if counted[member]:
                others = seen[nearest]
                counts[member, others[others != member][:number]] += 1
    return counts


def group_order(counts: Counts, core: int, eligible: npt.NDArray[np.bool_]) -> list[int]:
    """Order individuals so that the first N are a group of mutual neighbours, for every N.

    The bond of two individuals is the number of frames in which one is among the nearest six of
    the other, counted both ways; a group's score is the sum of its bonds. The best group of
    ``core`` out of the eligible is sought from each of them in turn: the strongest bond to the
    group is added until it is full, then members are swapped as long as the score rises. Inside
    that group, the member with the weakest bonds is peeled off last-first; all others follow by the
    strongest bond to those before. Ties fall to the lower index, so that the order is one and the
    same everywhere.

    Parameters
    ----------
    counts
        What :func:`neighbor_counts` returns.
    core
        Size of the group that is sought.
    eligible
        Who may be in it, shape ``(individual,)``.

    Returns
    -------
    A permutation of the individuals.
    """
    bonds = counts + counts.T
    np.fill_diagonal(bonds, 0)
    pool = np.flatnonzero(eligible)
    among = bonds[np.ix_(pool, pool)]
    candidates = [_grown(among, seed, core) for seed in range(len(pool))]
    scores = [among[np.ix_(group, group)].sum() for group in candidates]
    inside = pool[candidates[int(np.argmax(scores))]]
    group = np.isin(np.arange(len(bonds)), inside)
    peeled: list[int] = []
    while len(inside) > 1:
        weakest = int(np.argmin(bonds[np.ix_(inside, inside)].sum(axis=1)))
        peeled.append(int(inside[weakest]))
        inside = np.delete(inside, weakest)
    order = [int(inside[0]), *reversed(peeled)]
    while not group.all():
        order.append(int(np.argmax(np.where(group, -1, bonds[:, group].sum(axis=1)))))
        group[order[-1]] = True
    return order


def _grown(bonds: Counts, seed: int, size: int) -> npt.NDArray[np.bool_]:
    """Return who is in the group grown from one individual and bettered by swaps."""
    group = np.zeros(len(bonds), dtype=bool)
    group[seed] = True
    while group.sum() < size:
        group[int(np.argmax(np.where(group, -1, bonds[:, group].sum(axis=1))))] = True
    while not group.all():
        members, others = np.flatnonzero(group), np.flatnonzero(~group)
        to_group = bonds[:, group].sum(axis=1)
        gain = to_group[others] - to_group[members][:, None] - bonds[np.ix_(members, others)]
        leaves, joins = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[leaves, joins] <= 0:
            break
        group[members[leaves]], group[others[joins]] = False, True
    return group


def wall_distance(positions: Array) -> Array:
    """Return how near each individual of ``(time, individual, 2)`` ever comes to a wall."""
    low, high = np.transpose(WALLS)
    return np.asarray(np.nanmin(np.minimum(positions - low, high - positions), axis=(0, 2)))


def make_clip(source: Path) -> tuple[dict[str, npt.NDArray[Any]], list[str]]:
    """Return the arrays of the clip, and lines that tell how good its groups are."""
    with np.load(source, allow_pickle=False) as recording:
        window = (recording["frame"] >= FRAMES[0]) & (recording["frame"] < FRAMES[1])
        everyone = recording["xy"][window].astype(np.float64)
        frames, times = recording["frame"][window], recording["time_s"][window]
        names, fps = recording["id"], float(recording["fps"])
    tidy = drop_short_runs(everyone, MIN_RUN)
    present = tracked(tidy)
    kept = np.flatnonzero(present.mean(axis=0) >= MIN_PRESENCE)
    counts = neighbor_counts(everyone, present, NUM_NEIGHBORS)
    off_wall = wall_distance(tidy[:, kept]) >= MIN_WALL_DISTANCE
    chosen = kept[group_order(counts[np.ix_(kept, kept)], CORE, off_wall)]

    nearest = neighbor_counts(everyone, present, 1)
    lines = [describe(tidy[:, chosen[:n]], counts, nearest, chosen[:n]) for n in (10, 20, 30)]
    steps = np.linalg.norm(np.diff(tidy[:, chosen], axis=0), axis=-1)
    lines.append(
        f"{len(chosen)} fish: tracked {present[:, chosen].mean():.1%}, steps: median "
        f"{np.nanmedian(steps):.3f}, longest {np.nanmax(steps):.3f}, more than 5 medians: "
        f"{int((steps > 5 * np.nanmedian(steps)).sum())}"
    )
    rounded = (np.round(tidy[:, chosen] * GRID) / GRID).astype(np.float32)
    arrays: dict[str, npt.NDArray[Any]] = {
        # Time runs fastest in memory: the zip then packs it a fifth smaller.
        "xy": np.asfortranarray(rounded),
        "frame": frames.astype(np.int32),
        "time_s": times,
        "id": names[chosen].astype(np.int32),
        "fps": np.asarray(fps),
    }
    changes = CHANGES.format(
        first=FRAMES[0],
        last=FRAMES[1] - 1,
        kept=len(chosen),
        all=everyone.shape[1],
        presence=MIN_PRESENCE,
        run=MIN_RUN,
        grid=GRID,
    )
    texts = ABOUT | {"changes": changes}
    return arrays | {key: np.asarray(text) for key, text in texts.items()}, lines


def describe(positions: Array, counts: Counts, nearest: Counts, group: npt.NDArray[Any]) -> str:
    """Say how well tracked, how compact and how self-contained a group is."""
    present = tracked(positions)
    centre = np.nanmean(positions, axis=1, keepdims=True)
    radius = np.sqrt(np.nanmean(np.sum((positions - centre) ** 2, axis=-1)))
    pairs = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    pairs[np.isnan(pairs) | np.eye(len(group), dtype=bool)] = np.inf
    apart = pairs.min(axis=-1)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    inside = [c[np.ix_(group, group)].sum() / c[group].sum() for c in (nearest, counts)]
    return (
        f"N = {len(group)}: tracked {present.mean():.1%}, all at once "
        f"{present.all(axis=1).mean():.1%}, root mean square radius {radius:.2f}, median nearest "
        f"neighbour in the group {np.median(apart[present & np.isfinite(apart)]):.2f}, nearest of "
        f"all fish inside {inside[0]:.1%}, of the nearest six {inside[1]:.1%}, nearest to a wall "
        f"{wall_distance(positions).min():.1f}, steps over 5 "
        f"medians {int((steps > 5 * np.nanmedian(steps)).sum())}"
    )


def main() -> None:
    """Read the command line, cut the clip, and say what is in it."""
    parser = argparse.ArgumentParser(description="Cut the bundled clip of sunbleak.")
    parser.add_argument("source", type=Path, help="npz file of the whole window")
    parser.add_argument("destination", type=Path, help="npz file to write")
    parser.add_argument("--overwrite", action="store_true", help="replace the destination")
    arguments = parser.parse_args()
    check_output(arguments.destination, overwrite=arguments.overwrite)
    arrays, lines = make_clip(arguments.source)
    with (
        write_beside(arguments.destination, overwrite=arguments.overwrite) as path,
        path.open("wb") as stream,
    ):
        np.savez_compressed(stream, allow_pickle=False, **arrays)
    print("\n".join(lines))
    print(f"{arguments.destination}: {arguments.destination.stat().st_size} bytes")


if __name__ == "__main__":
    main()
