"""The how-tos run as they stand, and are as short as they promise."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
#: How-to -> lines of a user's own code that it may take, blank ones not counted.
LINES = {"another-prior": 5, "another-transition": 15, "another-guide": 20}
#: How-tos that take no code in a file of one's own.
WITHOUT = ("what-do-my-latents-mean", "which-rule-do-my-fish-follow")
NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?|–")
BLOCK = re.compile(r"^```(\w+) (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(name):
    """Return (language, what to do, text) of each block of a how-to that is to be run."""
    return BLOCK.findall((DOCS / f"{name}.md").read_text(encoding="utf-8"))


def test_all_are_tested():
    assert {path.stem for path in DOCS.glob("*.md")} == {*LINES, *WITHOUT}


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


@pytest.mark.parametrize("name", [*LINES, *WITHOUT])
def test_it_runs(name, tmp_path):
    """Files are written, then Python and the commands are run in the same folder."""
    ran, printed = 0, ""
    for language, action, text in blocks(name):
        if action.startswith("file="):
            (tmp_path / action.removeprefix("file=")).write_text(text)
            continue
        if action == "output":
            said = {words_of(line) for line in printed.splitlines()}
            for line in text.splitlines():
                assert words_of(line) in said, f"{line}\n{printed}"
            continue
        assert action == "run"
        if language == "python":
            commands = [
                [
                    sys.executable,
                    "-W",
                    "ignore",
                    "-c",
                    "import sys; sys.path.insert(0, '')\n" + text,
                ]
            ]
        else:
            lines = [line for line in text.splitlines() if line.strip()]
            assert all(line.startswith("swarmssm ") for line in lines)
            commands = [
                ["bash", "-c", line.replace("swarmssm", f"{sys.executable} -P -m swarmssm", 1)]
                for line in lines
            ]
        for command in commands:
            done = subprocess.run(
                command, cwd=tmp_path, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"
            assert done.stdout.strip()
            printed += done.stdout
            ran += 1
    assert ran >= 2
