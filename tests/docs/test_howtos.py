"""The how-tos run as they stand, and are as short as they promise."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
#: How-to -> lines of a user's own code that it may take, blank ones not counted.
LINES = {"another-prior": 5, "another-transition": 15, "another-guide": 20}
BLOCK = re.compile(r"^```(\w+) (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(name):
    """Return (language, what to do, text) of each block of a how-to that is to be run."""
    return BLOCK.findall((DOCS / f"{name}.md").read_text(encoding="utf-8"))


def test_all_are_tested():
    assert {path.stem for path in DOCS.glob("*.md")} == set(LINES)


@pytest.mark.parametrize("name", LINES)
def test_the_users_own_code_is_short(name):
    own = [text for _, action, text in blocks(name) if action.startswith("file=")]
    assert len(own) == 1
    lines = [line for line in own[0].splitlines() if line.strip()]
    assert len(lines) <= LINES[name]
    assert max(map(len, lines)) <= 100


@pytest.mark.parametrize("name", LINES)
def test_it_runs(name, tmp_path):
    """Files are written, then Python and the commands are run in the same folder."""
    ran = 0
    for language, action, text in blocks(name):
        if action.startswith("file="):
            (tmp_path / action.removeprefix("file=")).write_text(text)
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
            ran += 1
    assert ran >= 2
