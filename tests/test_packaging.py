"""What is shipped: wheel and source archive hold all of the package and nothing else to import."""

import email
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LINKS = ("models", "inference", "analysis")
NOT_SOURCES = shutil.ignore_patterns(
    ".*", "__pycache__", "*.egg-info", "build", "dist", "demo", "benchmarks"
)


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command and return what it prints; show all of it if it fails."""
    done = subprocess.run(
        [*map(str, command)],
        cwd=cwd,
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def package_files(root: Path) -> set[str]:
    """Return the files of the package, as paths from the root that a build should ship."""
    return {
        path.relative_to(root).as_posix()
        for path in (root / "swarmssm").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")
    }


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """Copy the checkout, links as links, so that building leaves nothing behind in this one."""
    return shutil.copytree(
        ROOT, tmp_path_factory.mktemp("sources") / "swarmssm", symlinks=True, ignore=NOT_SOURCES
    )


@pytest.fixture(scope="module")
def archives(checkout, tmp_path_factory):
    """Build the source archive, and the wheel from that archive."""
    out = tmp_path_factory.mktemp("archives")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, checkout, cwd=out)
    (sdist,) = out.glob("*.tar.gz")
    (wheel,) = out.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def sdist_names(archives):
    """Return the paths in the source archive below its one folder."""
    with tarfile.open(archives[0]) as archive:
        members = [member for member in archive.getmembers() if not member.isdir()]
    assert all(member.isfile() for member in members), "a link in the archive leads nowhere"
    return {member.name.partition("/")[2] for member in members}


@pytest.fixture(scope="module")
def wheel_names(archives):
    with zipfile.ZipFile(archives[1]) as archive:
        return {name for name in archive.namelist() if not name.endswith("/")}


@pytest.fixture(scope="module")
def installed(archives, tmp_path_factory):
    """Install the wheel alone into an empty folder."""
    target = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    run(*pip, "--target", target, archives[1], cwd=target)
    return target


def test_wheel_holds_the_package_whole(checkout, wheel_names):
    assert {name for name in wheel_names if name.startswith("swarmssm/")} == package_files(checkout)
    assert {f"swarmssm/{part}/__init__.py" for part in LINKS} <= wheel_names
    assert "swarmssm/py.typed" in wheel_names


def test_wheel_puts_nothing_else_at_top_level(wheel_names):
    tops = {name.partition("/")[0] for name in wheel_names}
    assert tops == {"swarmssm", f"swarmssm-{PROJECT['version']}.dist-info"}


def test_source_archive_holds_the_package_whole(checkout, sdist_names):
    assert {name for name in sdist_names if name.startswith("swarmssm/")} == package_files(checkout)
    assert {"pyproject.toml", "LICENSE", "NOTICE", "README.md", "CHANGELOG.md"} <= sdist_names


def test_source_archive_puts_nothing_else_at_top_level(sdist_names):
    folders = {name.partition("/")[0] for name in sdist_names if "/" in name}
    assert folders == {"swarmssm", "swarmssm.egg-info"}
    assert not {name for name in sdist_names if "/" not in name and name.endswith(".py")}


def test_wheel_from_the_checkout_is_the_wheel_from_the_archive(checkout, wheel_names, tmp_path):
    run(
        sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", tmp_path, checkout,
        cwd=tmp_path,
    )  # fmt: skip
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if not name.endswith("/")} == wheel_names


def test_metadata_name_licence_and_python(archives):
    with zipfile.ZipFile(archives[1]) as archive:
        folder = f"swarmssm-{PROJECT['version']}.dist-info"
        metadata = email.message_from_bytes(archive.read(f"{folder}/METADATA"))
        licence = archive.read(f"{folder}/licenses/LICENSE").decode()
        assert f"{folder}/licenses/NOTICE" in archive.namelist()
    assert metadata["Name"] == "swarmssm"
    assert metadata["License-Expression"] == "Apache-2.0"
    assert metadata["Requires-Python"] == ">=3.11"
    assert "Apache License" in licence
    assert "END OF TERMS AND CONDITIONS" in licence


def test_installed_wheel_imports_and_knows_its_version(installed):
    printed = run(
        sys.executable,
        "-P",
        "-c",
        "import swarmssm; print(swarmssm.__file__); print(swarmssm.__version__)",
        cwd=installed.parent,
        PYTHONPATH=str(installed),
    )
    assert printed.split() == [str(installed / "swarmssm/__init__.py"), PROJECT["version"]]


def test_installed_command_starts(installed):
    command = installed / "bin" / "swarmssm"
    printed = run(command, "--version", cwd=installed.parent, PYTHONPATH=str(installed))
    assert PROJECT["version"] in printed


def test_links_are_not_importable(tmp_path):
    look = "import importlib.util as u, sys; print([n for n in sys.argv[1:] if u.find_spec(n)])"
    assert run(sys.executable, "-I", "-c", look, *LINKS, "swarmssm", cwd=tmp_path) == (
        "['swarmssm']\n"
    )


def test_ruff_reads_every_file_once():
    shown = run(sys.executable, "-m", "ruff", "check", "--show-files", ".", cwd=ROOT).split()
    read = sorted(Path(name).relative_to(ROOT) for name in shown if name.endswith(".py"))
    written = sorted(
        path.relative_to(ROOT)
        for top in ("swarmssm", "tests")
        for path in ROOT.glob(f"{top}/**/*.py")
    )
    assert [path for path in read if path.parts[0] in {"swarmssm", "tests", *LINKS}] == written


def requirements() -> list[Requirement]:
    extras = PROJECT["optional-dependencies"]
    return [Requirement(text) for text in [*PROJECT["dependencies"], *extras["test"]]]


def constraints() -> dict[str, str]:
    """Return name -> version of constraints.txt."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line.split("==") for line in lines if line and not line.startswith("#")]
    assert all(len(pin) == 2 for pin in pins), "a line is not of the form name==version"
    assert len({canonicalize_name(name) for name, _ in pins}) == len(pins), "a name stands twice"
    return {canonicalize_name(name): version for name, version in pins}


@pytest.mark.parametrize("requirement", requirements(), ids=lambda requirement: requirement.name)
def test_every_requirement_is_pinned_within_its_range(requirement):
    pins = constraints()
    name = canonicalize_name(requirement.name)
    assert name in pins, f"{name} is not pinned in constraints.txt"
    assert requirement.specifier.contains(pins[name], prereleases=True)


def test_pins_install_anywhere():
    local = {name: version for name, version in constraints().items() if "+" in version}
    assert not local, "a local build, such as +cpu, is not on every index"


def test_torch_is_pinned():
    assert constraints()["torch"] == "2.13.0"


def test_the_readme_names_only_targets_that_exist():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    for page in ("README.md", "CONTRIBUTING.md"):
        named = set(re.findall(r"\bmake ([a-z-]+)", (ROOT / page).read_text(encoding="utf-8")))
        assert named, f"{page} names no target"
        assert named <= targets, f"{page} names targets that the Makefile lacks"


def test_the_ci_command_can_be_run():
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
