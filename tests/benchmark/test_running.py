"""Measurements in processes of their own, and what is left of them."""

import pytest

from swarmssm.benchmark import Job, jobs_of, make_task, run_jobs
from swarmssm.benchmark.measurements import part_path, read_part
from swarmssm.errors import InputError
from swarmssm.jobs import Progress

from .conftest import straight


def test_methods_are_measured_once_and_what_failed_has_its_reason(tmp_path):
    task = make_task(straight(120), horizons=(1, 5), origins=5, free_steps=10, samples=10)
    jobs = [Job("stay-put", 0), Job("sindy-oracle", 0)]
    told = []
    parts = run_jobs(task, jobs, tmp_path / "parts", processes=2, progress=told.append)
    assert parts[jobs[0]].measured.facts["mae"] == pytest.approx(1.0)
    assert parts[jobs[1]].measured is None
    assert "where the true forms are known" in parts[jobs[1]].reason
    assert told[0] == Progress(0, 2)
    assert told[-1] == Progress(2, 2, failed=1)

    path = part_path(tmp_path / "parts", "stay-put", 0)
    written = path.stat().st_mtime_ns
    again = run_jobs(task, jobs[:1], tmp_path / "parts")
    assert path.stat().st_mtime_ns == written
    assert again[jobs[0]].measured.facts == parts[jobs[0]].measured.facts

    with pytest.raises(InputError, match="are of other tracks or settings"):
        run_jobs(task, jobs[:1], tmp_path / "parts", seconds=3.0)
    path.write_bytes(b"half a file")
    assert read_part(path) is None


def test_methods_that_draw_are_repeated():
    jobs = jobs_of(["stay-put", "lstm"], 2)
    assert jobs == [
        Job("stay-put", 0),
        Job("lstm", 0),
        Job("lstm", 1),
    ]


@pytest.mark.parametrize(
    ("methods", "seeds", "said"),
    [
        (["lstn"], 1, "methods: 'lstn' is unknown; choose all, some of stay-put"),
        (["json:dumps"], 1, "json:dumps is no Baseline"),
        (["lstm", "lstm"], 1, "one stands there twice"),
        ([], 1, "none is given"),
        (["lstm"], 0, "seeds: it must be at least 1"),
    ],
)
def test_mistakes_are_told(methods, seeds, said):
    with pytest.raises(InputError, match=said):
        jobs_of(methods, seeds)
