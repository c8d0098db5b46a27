"""State that every test starts from and must leave behind, and the way to the real recordings."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pyro
import pytest
import torch
from hypothesis import settings

# The environment rather than `matplotlib.use`, so that commands run by a test draw off-screen too.
os.environ["MPLBACKEND"] = "Agg"

# Examples are the same on every run, and a busy machine fails no test for being slow.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")

pytest_plugins = ["pytester"]

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings: SWARMSSM_SHARED_DATA, or ../shared/data by the checkout."""
    named = os.environ.get("SWARMSSM_SHARED_DATA")
    if named:
        if not Path(named).is_dir():
            pytest.fail(f"SWARMSSM_SHARED_DATA={named} is not a folder. Mend it or unset it.")
        return Path(named)
    if not RECORDINGS.is_dir():
        pytest.skip("no real recordings: ../shared/data is absent, SWARMSSM_SHARED_DATA is not set")
    return RECORDINGS


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """A folder on a disk of 256 KiB."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "none", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("a small disk can only be mounted by root")
    yield folder
    # A writer that failed may hold its file open until it is collected.
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def _global_state() -> dict[str, object]:
    """Return the settings of torch, Pyro and matplotlib that outlive the code that sets them."""
    # matplotlib is asked only when something has drawn: importing it costs every worker a second.
    drawn = sys.modules.get("matplotlib")
    return {
        "torch's default dtype": torch.get_default_dtype(),
        "torch's gradient mode": torch.is_grad_enabled(),
        "validation of distributions": torch.distributions.Distribution._validate_args,
        "Pyro's validation": pyro.infer.util.is_validation_enabled(),
        "matplotlib's backend": drawn.get_backend().lower() if drawn else "agg",
    }


def _reset_global_state() -> None:
    torch.set_default_dtype(torch.float32)
    torch.set_grad_enabled(True)
    torch.set_num_threads(1)
    pyro.enable_validation(True)
    pyro.clear_param_store()
    pyro.set_rng_seed(0)
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")
    if matplotlib := sys.modules.get("matplotlib"):
        matplotlib.use("agg")


def pytest_sessionstart() -> None:
    """Reset the state before fixtures of module scope too, which come before those of a test."""
    _reset_global_state()


@pytest.fixture(autouse=True)
def global_state() -> Iterator[None]:
    """Start each test from the same global state, and fail the one that leaves another behind."""
    _reset_global_state()
    before = _global_state()
    yield
    after = _global_state()
    _reset_global_state()
    changed = [
        f"{name} ({before[name]} -> {after[name]})"
        for name in before
        if before[name] != after[name]
    ]
    if changed:
        pytest.fail("the test left behind a change of " + ", ".join(changed))
