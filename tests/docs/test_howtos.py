"""The how-tos run as they stand, and are as short as they promise."""

import re
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from swarmssm.cli import main

DOCS = Path(__file__).resolve().parents[2] / "docs"
#: How-to -> lines of a user's own code that it may take, blank ones not counted.
LINES = {
    "another-prior": 5,
    "another-force": 10,
    "another-transition": 21,
    "another-guide": 20,
    "comparing-methods": 12,
}
#: How-tos that take no code in a file of one's own.
WITHOUT = (
    "what-do-my-latents-mean",
    "which-rule-do-my-fish-follow",
    "checking-a-fitted-swarm",
    "comparing-models",
    "who-acts-on-whom",
    "figures",
)
#: Pages without anything to run: findings in recordings that are not part of the package, a map.
REPORTS = ("which-rule-each-species-follows", "design")
#: A few steps by gradients in place of Laplace's method, which goes on until it stays.
BRIEF = 'steps=5, guide_options={"globals": "multivariate"}'
SHORT = "--steps 5 --guide-option globals=multivariate"
#: What stands in a how-to -> less of it, for a quick look at whether it runs at all.
LESS = {
    "figures": {"--model boids": f"--model boids {SHORT}"},
    "comparing-methods": {"constant-velocity,ar5,ridge-boids,boids": "ar5"},
    "another-prior": {
        "steps=120": "steps=30",
        "--steps 120": "--steps 30",
        'guide="linearized")': f'guide="linearized", {BRIEF})',
        "--guide linearized": f"--guide linearized {SHORT}",
        "--model boids": f"--model boids {SHORT}",
    },
    "another-force": {"epochs=30": "epochs=2", "--epochs 30": SHORT},
    "another-transition": {"epochs=40": "epochs=2", "--epochs 40": SHORT},
    "another-guide": {"steps=120": "steps=60", "--steps 120": "--steps 60"},
    "what-do-my-latents-mean": {
        "--steps 100": "--steps 60",
        "--epochs 20": "--epochs 2",
        "epochs=20": "epochs=2",
        "shifts=39": "shifts=9",
        '"shifts": 39': '"shifts": 9',
    },
    "checking-a-fitted-swarm": {
        "load_sunbleak(6)": "load_sunbleak(4).isel(time=slice(0, 60))",
        'guide="linearized"': f'guide="linearized", {BRIEF}',
        "--draws 100": "--draws 10",
        "draws=40": "draws=10",
        "--draws 40": "--draws 10",
        "draws=20, origins=30": "draws=10, origins=5",
    },
    "comparing-models": {
        "slice(0, 120)": "slice(0, 80)",
        "--model linear --out": f"--model linear {SHORT} --out",
        "--model boids --model-option limits=false --model-option noise=additive": "--model linear "
        f"--model-option homing=false {SHORT}",
        "--origins 16 --draws 40": "--origins 4 --draws 12",
        "--draws 200": "--draws 100",
        "--draws 400": "--draws 100",
        ", draws=200": ", draws=100",
    },
    "who-acts-on-whom": {
        "--steps 300": "--steps 40",
        "--steps 250": "--steps 3",
        "--origins 16 --draws 40": "--origins 4 --draws 12",
        "--draws 5": "--draws 2",
    },
    "which-rule-do-my-fish-follow": {
        "slice(0, 100)": "slice(0, 40)",
        "--model kernel": f"--model kernel {SHORT}",
        "--draws 10": "--draws 4",
    },
}
NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?|–")
BLOCK = re.compile(r"^```(\w+) (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(name):
    """Return (language, what to do, text) of each block of a how-to that is to be run."""
    return BLOCK.findall((DOCS / f"{name}.md").read_text(encoding="utf-8"))


def test_all_are_tested():
    assert {path.stem for path in DOCS.glob("*.md")} == {*LINES, *WITHOUT, *REPORTS}


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_has_nothing_to_run_and_points_to_its_figures(name):
    assert not blocks(name)
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)", text):
        assert (DOCS / target).exists(), target


@pytest.mark.parametrize("name", LINES)
def test_the_users_own_code_is_short(name):
    own = [text for _, action, text in blocks(name) if action.startswith("file=")]
    assert len(own) == 1
    lines = [line for line in own[0].splitlines() if line.strip()]
    assert len(lines) <= LINES[name]
    assert max(map(len, lines)) <= 100


def words_of(line):
    """Return what a line of output says beside its numbers, its first cell of a table."""
    cells = [cell.strip() for cell in line.strip("│ ").split("│")]
    return " ".join(NUMBER.sub("#", cells[0]).split())


def outside(language, text, folder):
    """Run a block in processes of its own, one for each command; return what was printed by each.

    What a user writes in a file is imported as a user imports it.
    """
    if language == "python":
        code = "import sys; sys.path.insert(0, '')\n" + text
        commands = [[sys.executable, "-W", "ignore", "-c", code]]
    else:
        commands = [
            ["bash", "-c", line.replace("swarmssm", f"{sys.executable} -P -m swarmssm", 1)]
            for line in lines_of(text)
        ]
    for command in commands:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"
        yield done.stdout


def lines_of(text):
    """Return the commands of a block."""
    lines = [line for line in text.splitlines() if line.strip()]
    assert all(line.startswith("swarmssm ") for line in lines)
    return lines


def check(name, folder, run, less=None):
    """Write the files of a how-to, then run Python and the commands in the same folder."""
    ran, printed = 0, ""
    found = blocks(name)
    for old, new in (less or {}).items():
        assert any(action == "run" and old in text for _, action, text in found), old
        found = [(kind, action, text.replace(old, new)) for kind, action, text in found]
    for language, action, text in found:
        if action.startswith("file="):
            file = folder / action.removeprefix("file=")
            file.write_text(text)
            # Another test may have left a module of this name behind.
            sys.modules.pop(file.stem, None)
            continue
        if action == "output":
            said = {words_of(line) for line in printed.splitlines()}
            for line in text.splitlines():
                assert words_of(line) in said, f"{line}\n{printed}"
            continue
        assert action == "run"
        for told in run(language, text, folder):
            assert told.strip()
            printed += told
            ran += 1
    assert ran >= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", LINES)
def test_a_users_own_code_runs_as_it_stands(name, tmp_path):
    check(name, tmp_path, outside)


@pytest.fixture
def inside(monkeypatch, capsys, tmp_path):
    """Return a function that runs a block in this process, where nothing is imported anew."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def run(language, text, folder):
        if language == "python":
            with warnings.catch_warnings(action="ignore"):
                exec(compile(text, "how-to", "exec"), {"__name__": "__main__"})
            yield capsys.readouterr().out
            return
        for line in lines_of(text):
            monkeypatch.setattr(sys, "argv", shlex.split(line))
            with pytest.raises(SystemExit) as stopped:
                main()
            told = capsys.readouterr()
            assert not stopped.value.code, f"{line}\n{told.out}\n{told.err}"
            yield told.out

    return run


#: How-tos that take long even with less.
LONG = ("comparing-methods", "comparing-models", "who-acts-on-whom")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in LONG else ())
        for name in (*LINES, *WITHOUT)
    ],
)
def test_it_runs_with_less_of_everything(name, tmp_path, inside):
    check(name, tmp_path, inside, LESS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHOUT)
def test_it_runs_as_it_stands(name, tmp_path, inside):
    check(name, tmp_path, inside)
