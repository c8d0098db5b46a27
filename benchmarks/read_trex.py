"""How long it takes to read a large TRex recording: one npz file for each of 1126 individuals.

The files are made in a temporary folder: copies of the real ones in ``--source`` under other
numbers, or, where there are none, files of the same keys, lengths and size. Each round reads all
files anew; the operating system has them in its cache, as it has after TRex wrote them.

    python benchmarks/read_trex.py --individuals 1126 --rounds 3
"""

import argparse
import itertools
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from swarmssm.io import read

BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data" / "sunbleak_trex" / "trex_npz"
#: What TRex 1 exports by default.
KEYS = [
    "ACCELERATION#pcentroid",
    "ACCELERATION#wcentroid",
    "ANGLE",
    "ANGULAR_A#centroid",
    "ANGULAR_V#centroid",
    "AX",
    "AY",
    "BORDER_DISTANCE#pcentroid",
    "MIDLINE_OFFSET",
    "SPEED#wcentroid",
    "SPEED#smooth#wcentroid",
    "SPEED#pcentroid",
    "SPEED",
    "VX",
    "VY",
    "X#wcentroid",
    "X",
    "Y#wcentroid",
    "Y",
    "midline_length",
    "midline_x",
    "midline_y",
    "normalized_midline",
    "num_pixels",
    "segment_length",
    "timestamp",
]


def made_up_file(path: Path, generator: np.random.Generator, rows: int = 290) -> None:
    """Write a file such as TRex writes."""
    arrays = {key: generator.normal(50, 10, rows).astype(np.float32) for key in KEYS}
    frame = np.arange(1200, 1200 + rows, dtype=np.float32)
    missing = (generator.random(rows) < 0.2).astype(np.float32)
    np.savez(path, **arrays, frame=frame, missing=missing, time=frame / np.float32(40))


def make_folder(folder: Path, source: Path, individuals: int) -> str:
    """Fill a folder with one file for each individual, and say what they are."""
    originals = sorted(source.glob("*.npz"))
    generator = np.random.default_rng(0)
    for number, original in zip(
        range(individuals), itertools.cycle(originals or [None]), strict=False
    ):
        target = folder / f"recording.stitched_fish{number}.npz"
        if original is None:
            made_up_file(target, generator)
        else:
            shutil.copyfile(original, target)
    return f"copies of {len(originals)} real files" if originals else "made-up files"


def main() -> None:
    """Make the files, read them, print what it took."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--individuals", type=int, default=1126)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--source", type=Path, default=BESIDE)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kind = make_folder(folder, arguments.source, arguments.individuals)
        size = sum(file.stat().st_size for file in folder.iterdir())
        print(f"files    {arguments.individuals} ({kind}, {size / 1e6:.0f} MB)")
        for _ in range(arguments.rounds):
            start = time.perf_counter()
            tracks = read(folder)
            seconds = time.perf_counter() - start
            print(f"seconds  {seconds:.2f}   tracks {dict(tracks.sizes)}")


if __name__ == "__main__":
    main()
