"""The command as a user calls it, in this process."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from swarmssm.cli import main


class Outcome(NamedTuple):
    """What a call left behind."""

    status: int
    out: str
    err: str


Command = Callable[..., Outcome]


@pytest.fixture
def swarmssm(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Command:
    """Call ``swarmssm ARGUMENTS`` in an empty folder; return exit status, output, errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["swarmssm", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main()
        captured = capsys.readouterr()
        code = stopped.value.code
        return Outcome(int(code or 0), captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def flock_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three trials of five boids, 60 frames, with their truth."""
    from swarmssm import io
    from swarmssm.simulate import simulate_boids

    path = tmp_path_factory.mktemp("tracks") / "flock.nc"
    io.write(simulate_boids(5, 60, 3, seed=1), path)
    return path


@pytest.fixture(scope="session")
def run_folder(flock_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a few epochs on ``flock_file``. Copy it before changing it."""
    from swarmssm import inference, io

    folder = tmp_path_factory.mktemp("runs") / "run"
    tracks = io.read(flock_file)
    inference.fit("graph-vae", tracks, guide="encoder", source=flock_file, out=folder, epochs=3)
    return folder
