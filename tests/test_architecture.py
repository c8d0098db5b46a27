"""Imports go down the floors of the house, never up, and never in a circle.

The sources are read, not run, so that an import inside a function or under ``TYPE_CHECKING``
counts as much as one at the top of a file.
"""

import ast
import graphlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "swarmssm"
LINKS = ("models", "inference", "analysis")

# Module or sub-package -> floor. A module imports from its own floor and from those below.
FLOORS = {
    "errors": 1,
    "files": 1,
    "jobs": 1,
    "tracks": 1,
    "io": 1,
    "datasets": 1,
    "graphs": 1,
    "forces": 1,
    "metrics": 1,
    "simulate": 1,
    "models": 2,
    "inference": 3,
    "analysis": 4,
    "baselines": 5,
    "benchmark": 6,
    "cli": 7,
    "__main__": 7,
}
# The package itself (`swarmssm/__init__.py`) runs before any of its modules, so it stands lowest.
LOWEST = 1
PROBABILISTIC = 2  # the lowest floor that may import Pyro


class Import(NamedTuple):
    """One import as written: where it stands, what it names, and whether it ever runs."""

    module: str
    place: str
    target: str
    runs: bool


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def sources(root: Path, *folders: str) -> dict[str, Path]:
    """Return name -> path of all modules of the folders, leaving symbolic links aside."""
    paths = (path for folder in folders for path in sorted((root / folder).rglob("*.py")))
    return {module_name(path, root): path for path in paths}


def is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def nodes_with_runs(node: ast.AST, runs: bool = True) -> Iterator[tuple[ast.AST, bool]]:
    """Walk a tree, telling for each node whether it lies outside every ``if TYPE_CHECKING:``."""
    yield node, runs
    if isinstance(node, ast.If) and is_type_checking(node.test):
        for child in node.body:
            yield from nodes_with_runs(child, runs=False)
        for child in node.orelse:
            yield from nodes_with_runs(child, runs)
        return
    for child in ast.iter_child_nodes(node):
        yield from nodes_with_runs(child, runs)


def targets_of(node: ast.AST, package: str, modules: dict[str, Path]) -> list[str]:
    """Return the modules that a node imports, in full; `package` is what ``.`` stands for."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            anchor = package.split(".")
            anchor = anchor[: len(anchor) - (node.level - 1)]
            base = ".".join([*anchor, base] if base else anchor)
        # `from swarmssm import cli` names a module, `from swarmssm.cli import main` an object.
        full = [f"{base}.{alias.name}" for alias in node.names]
        return [name if name in modules else base for name in full]
    if isinstance(node, ast.Call) and node.args:
        called = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
        name = node.args[0]
        if (
            called in {"import_module", "__import__"}
            and isinstance(name, ast.Constant)
            and isinstance(name.value, str)
        ):
            return [name.value]
    return []


def imports(root: Path, *folders: str) -> list[Import]:
    """Return every import written in the Python files of the folders."""
    modules = sources(root, *folders)
    found = []
    # What a lazily loaded package offers stands in a stub beside it, and is imported on demand.
    stubs = {
        module: path.with_suffix(".pyi")
        for module, path in modules.items()
        if path.with_suffix(".pyi").exists()
    }
    for module, path in [*modules.items(), *stubs.items()]:
        package = module if path.stem == "__init__" else module.rpartition(".")[0]
        for node, runs in nodes_with_runs(ast.parse(path.read_text(encoding="utf-8"), str(path))):
            for target in targets_of(node, package, modules):
                place = f"{path.relative_to(root)}:{node.lineno}"
                found.append(Import(module, place, target, runs and path.suffix == ".py"))
    return found


def floor_of(module: str) -> int | None:
    """Return the floor of a module of the package, or None if it has not been given one."""
    parts = module.split(".")
    return LOWEST if len(parts) == 1 else FLOORS.get(parts[1])


def unplaced(root: Path) -> list[str]:
    names = {name.split(".")[1] for name in sources(root, PACKAGE) if "." in name}
    return [
        f"{PACKAGE}.{name} stands on no floor: place it in FLOORS of tests/test_architecture.py"
        for name in sorted(names - FLOORS.keys())
    ]


def upward(root: Path) -> list[str]:
    found = []
    for module, place, target, runs in imports(root, PACKAGE):
        if target.split(".")[0] != PACKAGE:
            continue
        if module == PACKAGE and not runs:
            continue  # The face of the package offers what stands above, and loads it on demand.
        own, other = floor_of(module), floor_of(target)
        if own is not None and other is not None and other > own:
            found.append(f"{place}: floor {own} ({module}) imports floor {other} ({target})")
    return found


def pyro_too_low(root: Path) -> list[str]:
    return [
        f"{place}: floor {floor} ({module}) imports {target}, allowed from {PROBABILISTIC} up"
        for module, place, target, _ in imports(root, PACKAGE)
        if target.split(".")[0] == "pyro"
        and (floor := floor_of(module)) is not None
        and floor < PROBABILISTIC
    ]


def through_links(root: Path) -> list[str]:
    return [
        f"{place}: imports {target} through a link of the repository; say {PACKAGE}.{target}"
        for _, place, target, _ in imports(root, PACKAGE, "tests", "benchmarks", "docs")
        if target.split(".")[0] in LINKS
    ]


def drawers(root: Path) -> list[str]:
    """Return modules and folders whose name says nothing of what they hold."""
    return [
        f"{name}: name it after the idea that it holds"
        for name in sources(root, PACKAGE, "tests", "benchmarks")
        if {"util", "utils"} & {part.strip("_") for part in name.split(".")}
    ]


def circles(root: Path) -> list[str]:
    """Return the first circle of imports that run, be it at once or when a function is called."""
    graph: dict[str, set[str]] = {name: set() for name in sources(root, PACKAGE)}
    for module, _, target, runs in imports(root, PACKAGE):
        if runs and target in graph and target != module:
            graph[module].add(target)
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        # The sorter lists a circle from the imported to the importing module.
        return [" imports ".join(reversed(error.args[1]))]
    return []


def shadowed(root: Path) -> list[str]:
    """Return modules that their package hides behind an object of the same name."""
    modules = sources(root, PACKAGE)
    found = []
    for module, path in modules.items():
        texts = [path, path.with_suffix(".pyi")] if path.stem == "__init__" else []
        for text in filter(Path.exists, texts):
            for node in ast.parse(text.read_text(encoding="utf-8")).body:
                if not isinstance(node, ast.ImportFrom):
                    continue
                base = f"{module}.{node.module}" if node.level and node.module else node.module
                hidden = {f"{module}.{alias.asname or alias.name}" for alias in node.names}
                if base not in (None, module):
                    found += [f"{name}: an object hides it" for name in sorted(hidden & {*modules})]
    return found


CHECKS = [unplaced, upward, pyro_too_low, through_links, drawers, circles, shadowed]


@pytest.mark.parametrize("check", CHECKS)
def test_the_house_stands(check):
    assert len(sources(ROOT, PACKAGE)) > 8, "the sources were not found"
    complaints = check(ROOT)
    assert not complaints, "\n".join(complaints)


@pytest.fixture
def planted(tmp_path):
    """Write a small sound house, to which a test adds one fault."""

    def plant(files: dict[str, str]) -> Path:
        house = {
            "swarmssm/__init__.py": "from importlib.metadata import version\n",
            "swarmssm/errors.py": "",
            "swarmssm/tracks.py": "from swarmssm.errors import InputError\n",
            "swarmssm/io/__init__.py": "from swarmssm.io.csv import read_csv\n",
            "swarmssm/io/csv.py": "from swarmssm import tracks\n",
            "swarmssm/models/__init__.py": "import pyro\nfrom swarmssm import io\n",
            "swarmssm/inference/__init__.py": "from swarmssm.models import Model\n",
            "swarmssm/analysis/__init__.py": "import swarmssm.inference\n",
            "swarmssm/cli.py": "def main():\n    from swarmssm.analysis import report\n",
            "tests/models/test_model.py": "from swarmssm.models import Model\n",
        }
        for name, text in {**house, **files}.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return plant


def test_a_sound_house_has_no_complaint(planted):
    root = planted({})
    assert [complaint for check in CHECKS for complaint in check(root)] == []


@pytest.mark.parametrize(
    ("where", "text", "complaint"),
    [
        (
            "swarmssm/tracks.py",
            "\nimport swarmssm.models\n",
            "swarmssm/tracks.py:2: floor 1 (swarmssm.tracks) imports floor 2 (swarmssm.models)",
        ),
        (
            "swarmssm/tracks.py",
            "from swarmssm import cli\n",
            "swarmssm/tracks.py:1: floor 1 (swarmssm.tracks) imports floor 7 (swarmssm.cli)",
        ),
        (
            "swarmssm/models/flock.py",
            "def fit():\n    from swarmssm.inference.fitting import fit\n",
            "swarmssm/models/flock.py:2: floor 2 (swarmssm.models.flock) imports floor 3 "
            "(swarmssm.inference.fitting)",
        ),
        (
            "swarmssm/inference/fitting.py",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import swarmssm.analysis\n",
            "swarmssm/inference/fitting.py:3: floor 3 (swarmssm.inference.fitting) imports floor 4 "
            "(swarmssm.analysis)",
        ),
        (
            "swarmssm/models/flock.py",
            "from ..inference import fit\n",
            "swarmssm/models/flock.py:1: floor 2 (swarmssm.models.flock) imports floor 3 "
            "(swarmssm.inference)",
        ),
        (
            "swarmssm/models/__init__.py",
            "from .. import analysis\n",
            "swarmssm/models/__init__.py:1: floor 2 (swarmssm.models) imports floor 4 "
            "(swarmssm.analysis)",
        ),
        (
            "swarmssm/io/csv.py",
            "import importlib\nimportlib.import_module('swarmssm.cli')\n",
            "swarmssm/io/csv.py:2: floor 1 (swarmssm.io.csv) imports floor 7 (swarmssm.cli)",
        ),
        (
            "swarmssm/__init__.py",
            "from swarmssm.models import Model\n",
            "swarmssm/__init__.py:1: floor 1 (swarmssm) imports floor 2 (swarmssm.models)",
        ),
    ],
)
def test_an_upward_import_is_found(planted, where, text, complaint):
    assert upward(planted({where: text})) == [complaint]


def test_a_stub_counts_as_what_it_offers(planted):
    """The face of the package may offer any floor; a lazy package within it only those below."""
    face = planted({"swarmssm/__init__.pyi": "from .models import Model\n"})
    assert upward(face) == []
    room = planted(
        {
            "swarmssm/io/__init__.py": "",
            "swarmssm/io/__init__.pyi": "from ..models import Model\n",
        }
    )
    assert upward(room) == [
        "swarmssm/io/__init__.pyi:1: floor 1 (swarmssm.io) imports floor 2 (swarmssm.models)"
    ]


def test_a_module_without_a_floor_is_found(planted):
    root = planted({"swarmssm/attic.py": "", "swarmssm/cellar/__init__.py": ""})
    assert [complaint.split(":")[0] for complaint in unplaced(root)] == [
        "swarmssm.attic stands on no floor",
        "swarmssm.cellar stands on no floor",
    ]


@pytest.mark.parametrize(
    "text", ["import pyro\n", "def draw():\n    import pyro.distributions as dist\n"]
)
def test_pyro_on_the_first_floor_is_found(planted, text):
    (complaint,) = pyro_too_low(planted({"swarmssm/io/csv.py": text}))
    assert complaint.startswith("swarmssm/io/csv.py:")


def test_an_import_through_a_link_is_found(planted):
    root = planted({"tests/models/test_model.py": "from models.layers import Layer\n"})
    assert through_links(root) == [
        "tests/models/test_model.py:1: imports models.layers through a link of the repository; "
        "say swarmssm.models.layers"
    ]


def test_a_drawer_is_found(planted):
    root = planted({"swarmssm/io/utils.py": "", "swarmssm/models/_util/__init__.py": ""})
    assert len(drawers(root)) == 2


def test_a_circle_is_found_even_inside_a_function(planted):
    root = planted(
        {
            "swarmssm/io/csv.py": "from swarmssm.io import excel\n",
            "swarmssm/io/excel.py": "def read():\n    from swarmssm.io import hdf\n",
            "swarmssm/io/hdf.py": "import swarmssm.io.csv\n",
        }
    )
    (circle,) = circles(root)
    names = [name.removeprefix("swarmssm.io.") for name in circle.split(" imports ")]
    assert set(itertools.pairwise(names)) == {("csv", "excel"), ("excel", "hdf"), ("hdf", "csv")}


def test_a_circle_for_type_checkers_alone_is_allowed(planted):
    root = planted(
        {
            "swarmssm/io/csv.py": "from swarmssm.io import excel\n",
            "swarmssm/io/excel.py": (
                "import typing\nif typing.TYPE_CHECKING:\n    from swarmssm.io import csv\n"
            ),
        }
    )
    assert circles(root) == []


def test_links_at_the_root_are_relative_and_lead_into_the_package():
    for link in LINKS:
        assert (ROOT / link).is_symlink(), f"{link} is not a symbolic link"
        assert (ROOT / link).readlink() == Path(PACKAGE, link)
