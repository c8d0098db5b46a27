"""The guard of the global state fails a test that leaves it changed, and shields the next one."""

from pathlib import Path

import pytest

CHANGES = {
    "torch's default dtype": "import torch; torch.set_default_dtype(torch.float64)",
    "torch's gradient mode": "import torch; torch.set_grad_enabled(False)",
    "validation of distributions": "import pyro; pyro.enable_validation(False)",
    "matplotlib's backend": "import matplotlib; matplotlib.use('svg')",
}


@pytest.fixture
def run(pytester):
    """Run the text of a test file under this folder's conftest.py, in the same process."""
    pytester.makeconftest(Path(__file__).with_name("conftest.py").read_text(encoding="utf-8"))

    def run(text: str) -> tuple[dict[str, int], str]:
        pytester.makepyfile(text)
        result = pytester.runpytest_inprocess("-p", "no:xdist", "-p", "no:cacheprovider")
        return result.parseoutcomes(), result.stdout.str()

    return run


@pytest.mark.parametrize(("name", "change"), CHANGES.items())
def test_a_test_that_changes_global_state_fails(run, name, change):
    outcomes, output = run(
        f"def test_change():\n    {change}\n"
        "def test_next():\n"
        "    import torch, matplotlib, pyro\n"
        "    assert torch.get_default_dtype() is torch.float32 and torch.is_grad_enabled()\n"
        "    assert pyro.infer.util.is_validation_enabled()\n"
        "    assert matplotlib.get_backend().lower() == 'agg'\n"
    )
    assert outcomes == {"passed": 2, "errors": 1}
    assert f"the test left behind a change of {name} (" in output


def test_draws_and_parameters_start_afresh(run):
    outcomes, _ = run(
        "import pytest\n"
        "drawn = set()\n"
        "@pytest.mark.parametrize('turn', [1, 2])\n"
        "def test_draw(turn):\n"
        "    import numpy, pyro, random, torch\n"
        "    assert not pyro.get_param_store()\n"
        "    pyro.param('gain', torch.ones(()))\n"
        "    drawn.add((torch.rand(()).item(), numpy.random.rand(), random.random()))\n"
        "    assert len(drawn) == 1\n"
    )
    assert outcomes == {"passed": 2}


@pytest.mark.parametrize(("present", "outcome"), [(True, "passed"), (False, "errors")])
def test_recordings_are_taken_from_the_folder_that_is_named(
    run, tmp_path, monkeypatch, present, outcome
):
    folder = tmp_path / "recordings"
    if present:
        folder.mkdir()
    monkeypatch.setenv("SWARMSSM_SHARED_DATA", str(folder))
    outcomes, _ = run(
        f"def test_it(shared_data):\n    assert str(shared_data) == {str(folder)!r}\n"
    )
    assert outcomes == {outcome: 1}


def test_a_test_of_absent_recordings_is_skipped(run, monkeypatch):
    monkeypatch.delenv("SWARMSSM_SHARED_DATA", raising=False)
    outcomes, _ = run("def test_it(shared_data):\n    assert False\n")
    assert outcomes == {"skipped": 1}
