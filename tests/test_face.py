"""``import swarmssm as sw``: what it offers, and that it introduces itself truly."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import swarmssm as sw

ROOT = Path(__file__).resolve().parents[1]


def test_every_name_is_there_when_it_is_asked_for():
    assert set(sw.__all__) <= set(dir(sw))
    for package in (sw, sw.analysis):
        for name in package.__all__:
            assert getattr(package, name) is not None
    assert sw.fit is sw.inference.fit
    with pytest.raises(AttributeError, match="colour"):
        _ = sw.colour


def test_nothing_is_imported_before_it_is_needed():
    code = "import sys, swarmssm; print({'torch', 'pandas', 'xarray'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
    code = "import sys, swarmssm.cli; print({'torch', 'pandas', 'numpy'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_introduction_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    block = inspect.cleandoc(sw.__doc__).split("::\n\n")[1].split("\n\n")
    lines = inspect.cleandoc("\n\n".join(block[:2])).replace(
        "individuals=8, steps=200", "individuals=3, steps=40"
    )
    assert len([line for line in lines.splitlines() if line.strip()]) <= 10
    exec(lines, {})
    printed = capsys.readouterr().out
    assert "boids" in printed
    assert "cohesion_gain" in printed
    assert sw.Fit.load("run").settings.model == "boids"


@pytest.mark.parametrize("link", ["models", "inference", "analysis"])
def test_a_link_at_the_root_is_not_imported_through(link):
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import {link}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert f"ImportError: Write swarmssm.{link}" in done.stderr
