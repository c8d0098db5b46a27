import hashlib
import os
import resource
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch
import xarray as xr

from swarmssm.errors import InputError, SwarmssmError, WorkError
from swarmssm.files import check_output, file_digest, write_beside


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A file that holds ``old`` and lies alone in its folder."""
    path = tmp_path / "result.csv"
    path.write_text("old")
    return path


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))


def test_each_error_is_what_a_caller_may_catch_and_bears_its_exit_status():
    assert InputError.exit_status == 2
    assert WorkError.exit_status == 1
    assert issubclass(InputError, ValueError)
    assert issubclass(WorkError, RuntimeError)
    assert issubclass(InputError, SwarmssmError)
    assert issubclass(WorkError, SwarmssmError)
    assert str(InputError("fish.nc: no.")) == "fish.nc: no."


def test_a_write_puts_the_whole_new_file_in_place(tmp_path: Path):
    path = tmp_path / "new.txt"
    with write_beside(path) as temporary:
        assert temporary.parent == path.parent
        assert not path.exists()
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert names(tmp_path) == ["new.txt"]


def test_a_write_may_replace_only_when_told(old: Path):
    with pytest.raises(InputError, match=r"result.csv: exists already .* overwrite=True"):  # noqa: SIM117
        with write_beside(old):
            pytest.fail("the work was done before the refusal")
    with write_beside(old, overwrite=True) as temporary:
        temporary.write_text("new")
        assert old.read_text() == "old"
    assert old.read_text() == "new"
    assert names(old.parent) == ["result.csv"]


@pytest.mark.parametrize("error", [ValueError("bad"), KeyboardInterrupt(), InputError("mine")])
def test_work_that_fails_leaves_the_old_file_and_passes_its_error_on(
    old: Path, error: BaseException
):
    with (  # noqa: PT012
        pytest.raises(type(error)) as caught,
        write_beside(old, overwrite=True) as temporary,
    ):
        temporary.write_text("half")
        raise error
    assert caught.value is error
    assert old.read_text() == "old"
    assert names(old.parent) == ["result.csv"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_without_space_is_told_in_one_sentence(old: Path):
    with (  # noqa: PT012
        pytest.raises(WorkError) as caught,
        write_beside(old, overwrite=True) as temporary,
    ):
        temporary.write_text("half")
        with Path("/dev/full").open("w") as stream:
            stream.write("x")
    assert str(caught.value) == (
        f"{old}: could not be written (No space left on device); what was there before is "
        "unchanged."
    )
    assert old.read_text() == "old"
    assert names(old.parent) == ["result.csv"]


def test_a_reader_of_the_old_file_reads_all_of_it(old: Path):
    with old.open() as reader:
        with write_beside(old, overwrite=True) as temporary:
            temporary.write_text("new")
            written = temporary.stat().st_ino
        assert reader.read() == "old"
    # Renamed, not copied: there was no moment at which it was half there.
    assert old.stat().st_ino == written


def test_a_file_that_grows_too_large_leaves_the_old_one(old: Path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.raises(WorkError, match="File too large"):  # noqa: PT012
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
        try:
            with write_beside(old, overwrite=True) as temporary:
                temporary.write_bytes(bytes(10_000))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert old.read_text() == "old"
    assert names(old.parent) == ["result.csv"]


def _netcdf(path: Path) -> None:
    xr.Dataset({"a": ("x", np.random.default_rng(0).random(200_000))}).to_netcdf(
        path, engine="h5netcdf"
    )


def _npz(path: Path) -> None:
    with path.open("wb") as stream:
        np.savez(stream, a=np.random.default_rng(0).random(200_000))


WRITERS = {
    "bytes": lambda path: path.write_bytes(bytes(1_000_000)),
    "netcdf": _netcdf,
    "npz": _npz,
    "torch": lambda path: torch.save(torch.rand(200_000), path),
    "safetensors": lambda path: safetensors.torch.save_file({"a": torch.rand(200_000)}, path),
}


@pytest.mark.parametrize("writer", WRITERS)
# HDF5 closes its file a second time when it is collected, and fails a second time.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_full_disk_leaves_the_old_file_whatever_the_writer(full_disk: Path, writer: str):
    path = full_disk / "result"
    path.write_text("old")
    with (
        pytest.raises(WorkError) as caught,
        write_beside(path, overwrite=True) as temporary,
    ):
        WRITERS[writer](temporary)
    assert str(caught.value) == (
        f"{path}: could not be written (No space left on device); what was there before is "
        "unchanged."
    )
    assert path.read_text() == "old"
    assert names(full_disk) == ["result"]


def test_a_process_killed_while_writing_leaves_the_old_file(old: Path):
    program = (
        "import sys, time; from pathlib import Path; from swarmssm.files import write_beside\n"
        "with write_beside(Path(sys.argv[1]), overwrite=True) as temporary:\n"
        "    temporary.write_text('half'); print('half', flush=True); time.sleep(600)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(old)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    with process.stdout as stdout:
        assert stdout.readline() == "half\n"
        process.kill()
        assert process.wait(60) == -signal.SIGKILL
    assert old.read_text() == "old"
    left = [name for name in names(old.parent) if name != "result.csv"]
    # Nothing can tidy up after a kill; what is left is hidden and passes for no data file.
    assert all(name.startswith(".result.csv.") and name.endswith(".part") for name in left)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="this system has no /proc")
def test_a_folder_that_takes_no_files_is_told():
    with pytest.raises(WorkError, match=r"^/proc/self/fd/a.nc: cannot be written \("):  # noqa: SIM117
        with write_beside(Path("/proc/self/fd/a.nc")):
            pytest.fail("the work was done before the refusal")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_told(tmp_path: Path):
    tmp_path.chmod(0o555)
    try:
        with pytest.raises(WorkError, match=r"Permission denied"):  # noqa: SIM117
            with write_beside(tmp_path / "a.nc"):
                pytest.fail("the work was done before the refusal")
    finally:
        tmp_path.chmod(0o755)


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_new_file_has_the_permissions_that_the_umask_asks_for(
    tmp_path: Path, mask: int, mode: int
):
    before = os.umask(mask)
    try:
        with write_beside(tmp_path / "a.txt") as temporary:
            temporary.write_text("a")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == mode


@pytest.mark.parametrize("mode", [0o600, 0o444, 0o755])
def test_a_replaced_file_keeps_its_permissions_also_while_it_is_written(old: Path, mode: int):
    old.chmod(mode)
    with write_beside(old, overwrite=True) as temporary:
        temporary.write_text("new")
        assert stat.S_IMODE(temporary.stat().st_mode) == mode | 0o600
    assert stat.S_IMODE(old.stat().st_mode) == mode
    assert old.read_text() == "new"


def test_a_link_goes_on_pointing_to_the_file_that_is_replaced(old: Path, tmp_path: Path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link = elsewhere / "link.csv"
    link.symlink_to(old)
    with write_beside(link, overwrite=True) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert old.read_text() == "new"
    assert names(elsewhere) == ["link.csv"]
    assert names(tmp_path) == ["elsewhere", "result.csv"]


def test_names_as_long_as_the_system_allows_can_be_written(tmp_path: Path):
    path = tmp_path / ("ä" * 127)  # 254 bytes
    with write_beside(path) as temporary:
        temporary.write_text("a")
    assert path.read_text() == "a"
    with pytest.raises(InputError, match=r"cannot be written \(File name too long\)"):
        check_output(tmp_path / ("ä" * 128))


def test_output_paths_are_refused_before_any_work(old: Path, tmp_path: Path):
    assert check_output(tmp_path / "new.nc") == tmp_path / "new.nc"
    assert check_output(old, overwrite=True) == old
    with pytest.raises(InputError, match=r"the folder .*/absent does not exist. Make it first."):
        check_output(tmp_path / "absent" / "a.nc")
    with pytest.raises(InputError, match="this is a folder, and a file is to be written"):
        check_output(tmp_path, overwrite=True)
    with pytest.raises(InputError, match=r"the folder .*result.csv does not exist"):
        check_output(old / "a.nc")
    assert old.read_text() == "old"


def test_a_device_is_never_replaced_by_a_file(tmp_path: Path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path(os.devnull)):
        with pytest.raises(InputError, match="this is no ordinary file"):  # noqa: SIM117
            with write_beside(path, overwrite=True):
                pytest.fail("the work was done before the refusal")
    assert pipe.is_fifo()
    assert Path(os.devnull).is_char_device()


def test_digest_is_the_sha256_of_the_bytes(tmp_path: Path):
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    # The first example of FIPS 180-2, appendix B.1.
    assert file_digest(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    path.write_bytes(bytes(range(256)) * 10_000)
    assert file_digest(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    with pytest.raises(InputError, match=r"absent: cannot be read \(No such file or directory\)."):
        file_digest(tmp_path / "absent")
