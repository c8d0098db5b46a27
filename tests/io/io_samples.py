"""Small files as trackers write them, around one motion that is known in the head.

``MOTION[t, i] = (10 i + t, 100 + i - t / 2)``: three individuals, six frames, straight lines, never
equal in x and y. Individual 1 is not tracked in frame 2.
"""

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet

FRAMES, MEMBERS = 6, 3
t, i = np.mgrid[:FRAMES, :MEMBERS].astype(float)
MOTION = np.stack([10 * i + t, 100 + i - t / 2], axis=-1)
MOTION[2, 1] = np.nan
FPS = 25.0


def positions(tracks):
    """Return ``(..., time, individual, space)`` of tracks."""
    return np.swapaxes(tracks["position"].to_numpy(), -1, -2)


def trex_arrays(member=0, *, first=0, motion=MOTION, fps=FPS, version=1, **more):
    """Return the arrays of one individual as TRex 1 or 2 exports them; inf where missing."""
    xy = motion[:, member]
    missing = np.isnan(xy[:, 0])
    frame = np.arange(first, first + len(xy))
    invalid = np.full(len(xy), np.inf)
    arrays = {
        "X#wcentroid": np.where(missing, np.inf, xy[:, 0]),
        "Y#wcentroid": np.where(missing, np.inf, xy[:, 1]),
        "X": invalid,
        "Y": invalid,
        "SPEED#wcentroid": np.where(missing, np.inf, 1.0),
        "frame": frame,
        "missing": missing,
        "time": frame / fps,
    }
    arrays = {key: values.astype(np.float32) for key, values in arrays.items()}
    if version == 1:
        arrays["frame_segments"] = np.array([[first, first + len(xy) - 1]], dtype=np.int32)
    else:
        arrays["tracklets"] = np.array([[first, first + len(xy) - 1]], dtype=np.int32)
        arrays["cm_per_pixel"] = np.array([0.5])
        arrays["id"] = np.array([member], dtype=np.uint64)
        arrays["frame_rate"] = np.array([fps])
        arrays["video_size"] = np.array([1920.0, 1080.0])
        arrays["detect_type"] = np.array([1], dtype=np.uint32)
    arrays.update(more)
    return {key: values for key, values in arrays.items() if values is not None}


def write_trex(folder, *, names=("fish0", "fish1", "fish2"), video="video", **options):
    """Write one npz file for each individual, as TRex does."""
    folder.mkdir(exist_ok=True)
    for member, name in enumerate(names):
        np.savez(folder / f"{video}_{name}.npz", **trex_arrays(member, **options))
    return folder


def visual_field_arrays(own, seen, frames, *, version=2, rays=512):
    """Return a visual field in which ``own`` sees ``seen[f]`` in the f-th frame.

    The first two rays of each eye meet the own body, the next ones those who are seen: odd ones
    in the left eye, even ones in the right. Behind the first of them stands individual 0 (layer 1).
    """
    count = len(frames)
    nothing = np.finfo(np.float32).max
    depth = np.full((count, 2, 2, rays), nothing, dtype=np.float32)
    ids = np.full((count, 2, 2, rays), -1, dtype=np.int32)
    ids[:, :, 0, :2] = own
    depth[:, :, 0, :2] = 4.0
    for row, others in enumerate(seen):
        for ray, other in enumerate(others, start=2):
            ids[row, other % 2, 0, ray] = other
            depth[row, other % 2, 0, ray] = 900.0
        ids[row, :, 1, 2] = 0
        depth[row, :, 1, 2] = 1600.0
    arrays = {
        "depth": depth,
        "ids": ids,
        "body_part": np.where(ids >= 0, np.float32(100), np.float32(-1)),
        "colors": np.zeros((3, 4), dtype=np.int32),
        "fov_range": np.radians([-130.0, 130.0]),
        "frame_range": np.array([frames[0], frames[-1]], dtype=np.int32),
        "fish_pos": np.stack([np.arange(count) + own * 10.0, np.full(count, 50.0)], -1),
        "fish_angle": np.zeros(count, dtype=np.float32),
        "eye_pos": np.zeros((count, 2, 2), dtype=np.float32),
        "eye_angle": np.zeros((count, 2), dtype=np.float32),
        "frames": np.asarray(frames, dtype=np.int32),
    }
    if version == 2:
        arrays["visible_points"] = np.zeros((count, 2, 2, rays, 2), dtype=np.float32)
    return arrays


def write_visual_field(folder, name, arrays, *, split=False, video="video"):
    """Write a visual field as one npz file, or split as TRex does with a large one."""
    stem = f"{video}_visual_field_{name}"
    if not split:
        np.savez(folder / f"{stem}.npz", **arrays)
        return
    for key in ("depth", "ids", "body_part"):
        np.save(folder / f"{stem}_{key}.npy", arrays[key])
    large = ("depth", "ids", "body_part", "visible_points")
    np.savez(folder / f"{stem}_meta.npz", **{k: v for k, v in arrays.items() if k not in large})


def idtrackerai_dict(motion=MOTION, **more):
    """Return what idtracker.ai 6 writes, in its own keys."""
    members = motion.shape[1]
    probability = np.where(np.isnan(motion[..., :1]), 0.0, 0.75)
    said = {
        "trajectories": motion,
        "id_probabilities": probability,
        "version": "6.0.14",
        "height": 1080,
        "width": 1920,
        "video_paths": ["/videos/a.avi", "/videos/b.avi"],
        "frames_per_second": 28,
        "body_length": 58.5,
        "estimated_accuracy": 0.999,
        "areas": {key: np.arange(members) + 300.0 for key in ("mean", "median", "std")},
        "setup_points": {"corner": np.array([[1, 2], [3, 4]])},
        "identities_labels": [f"fish {n}" for n in range(members)],
        "identities_groups": {"males": [1, 2]},
        "length_unit": None,
    }
    return {**said, **more}


def write_idtrackerai_h5(path, said):
    """Write the h5 file as idtracker.ai 6 lays it out."""
    said = dict(said)
    with h5py.File(path, "w") as file:
        for name in ("areas", "setup_points", "identities_groups"):
            group = file.create_group(name)
            for key, value in said.pop(name).items():
                group.create_dataset(key, data=np.asarray(value))
        file.attrs["length_unit"] = said.pop("length_unit") or -1
        for key, value in said.items():
            if value is None:
                continue
            if isinstance(value, int | float | str | list):
                file.attrs[key] = value
            else:
                file.create_dataset(key, data=value, compression="gzip")
    return path


def _json(said):
    rest = {k: v for k, v in said.items() if k not in ("trajectories", "id_probabilities")}
    return json.dumps(rest, default=lambda value: np.asarray(value).tolist())


def write_idtrackerai_csv(folder, said):
    """Write the folder ``trajectories_csv``."""
    folder.mkdir()
    motion = said["trajectories"]
    frames, members = motion.shape[:2]
    seconds = np.arange(frames)[:, None] / said["frames_per_second"]
    for name, values, columns in (
        (
            "trajectories",
            motion.reshape(frames, -1),
            [f"{axis}{n}" for n in range(1, members + 1) for axis in "xy"]
            if members > 1
            else ["trajectories1", "trajectories2"],
        ),
        (
            "id_probabilities",
            said["id_probabilities"].reshape(frames, -1),
            [f"id_probabilities{n}" for n in range(1, members + 1)],
        ),
    ):
        np.savetxt(
            folder / f"{name}.csv",
            np.hstack([seconds, values]),
            delimiter=",",
            header=",".join(["time", *columns]),
            fmt="%.3f",
            comments="",
        )
    np.savetxt(
        folder / "areas.csv",
        np.stack(list(said["areas"].values()), -1),
        delimiter=", ",
        header="mean, median, standard_deviation",
        fmt="%.1f",
        comments="",
    )
    rest = {key: value for key, value in said.items() if key != "areas"}
    (folder / "attributes.json").write_text(_json(rest))
    return folder


def tidy_frame(said):
    """Return the rows of the tidy forms."""
    motion = said["trajectories"]
    frames, members = motion.shape[:2]
    frame = np.repeat(np.arange(frames), members)
    return pd.DataFrame(
        {
            "frame": frame,
            "time": frame / said["frames_per_second"],
            "individual": np.tile(np.arange(members), frames),
            "x": motion[..., 0].ravel(),
            "y": motion[..., 1].ravel(),
            "probability": said["id_probabilities"].ravel(),
        }
    )


def write_idtrackerai_tidy(folder, said):
    """Write ``trajectories_tidy.csv`` and its companion."""
    path = folder / "trajectories_tidy.csv"
    frame = tidy_frame(said)
    frame.to_csv(path, index=False, float_format="%.3f", na_rep="nan")
    (folder / "attributes_tidy.json").write_text(_json(said))
    return path


def write_idtrackerai_parquet(path, said):
    """Write the parquet file with the settings in its schema."""
    table = pyarrow.Table.from_pandas(tidy_frame(said))
    metadata = {**(table.schema.metadata or {}), "idtrackerai_attributes": _json(said).encode()}
    pyarrow.parquet.write_table(table.replace_schema_metadata(metadata), path)
    return path


def write_idtracker(path: Path, motion=MOTION):
    """Write ``trajectories.txt`` of the classic idTracker: tabs, also at the end of each line."""
    members = motion.shape[1]
    lines = ["".join(f"X{n}\tY{n}\tProbId{n}\t" for n in range(1, members + 1))]
    for row in motion:
        cells = []
        for x, y in row:
            cells += ["NaN", "NaN", "NaN"] if np.isnan(x) else [f"{x:.4f}", f"{y:.4f}", "0.5"]
        lines.append("\t".join(cells) + "\t")
    path.write_text("\n".join(lines) + "\n")
    return path


def wide_text(motion=MOTION, *, sep=",", head="frame"):
    """Return a wide table with a column of frame numbers."""
    members = motion.shape[1]
    lines = [sep.join([head] + [f"{axis}{n}" for n in range(members) for axis in "xy"])]
    for frame, row in enumerate(motion):
        cells = ["" if np.isnan(v) else f"{v:g}" for v in row.ravel()]
        lines.append(sep.join([str(frame), *cells]))
    return "\n".join(lines) + "\n"


def long_text(motion=MOTION, *, sep=","):
    """Return a long table; rows of what was not tracked are absent."""
    lines = [sep.join(["frame", "id", "x", "y"])]
    for frame, row in enumerate(motion):
        for member, (x, y) in enumerate(row):
            if not np.isnan(x):
                lines.append(sep.join([str(frame), str(member), f"{x:g}", f"{y:g}"]))
    return "\n".join(lines) + "\n"
