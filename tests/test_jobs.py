"""Work in pieces: kept as it is done, gone on with, refused where it does not fit."""

import importlib
import json
import signal

import pytest
import torch

from swarmssm import jobs
from swarmssm.errors import InputError, WorkError
from swarmssm.jobs import Progress, parallel_map


def square(index):
    return {"value": index**2}


def square_or_fail(index):
    return {"failed": "odd"} if index % 2 else square(index)


def interrupt_at_three(index):
    if index == 3:
        raise KeyboardInterrupt
    return square(index)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """Work that other processes can find: in a module on their path."""
    source = "import os\n\ndef square(i):\n    return {'value': i * i}\n\n"
    source += "def die(i):\n    os._exit(1)\n\n"
    source += "def divide(i):\n    return {'value': 1 / 0}\n\n"
    source += "def die_or_sleep(i):\n    import time\n    if i == 0:\n        os._exit(1)\n"
    source += "    time.sleep(60 * (i == 2))\n    return {'value': i}\n\n"
    source += "def threads(i):\n    import torch\n    return {'value': torch.get_num_threads()}\n"
    (tmp_path / "work_elsewhere.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    return importlib.import_module("work_elsewhere")


def values(rows):
    return [row["value"] for row in rows]


@pytest.mark.parametrize("processes", [1, 2])
def test_rows_come_in_order_and_stand_in_the_file(tmp_path, elsewhere, processes):
    out = tmp_path / "rows.jsonl"
    rows = parallel_map(elsewhere.square, range(4), settings={"a": 1}, out=out, processes=processes)
    assert values(rows) == [0, 1, 4, 9]
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert lines[0] == {"settings": {"a": 1}}
    assert sorted(line["index"] for line in lines[1:]) == [0, 1, 2, 3]


@pytest.mark.slow
def test_processes_begin_as_they_should(elsewhere):
    assert values(parallel_map(elsewhere.threads, range(2), settings={}, processes=2)) == [1, 1]


def test_a_process_has_one_thread_and_ends_when_told():
    before = signal.getsignal(signal.SIGINT)
    torch.set_num_threads(2)
    try:
        jobs._prepare_process()
        assert torch.get_num_threads() == 1
        assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGINT, before)


def test_what_was_interrupted_is_gone_on_with(tmp_path):
    out = tmp_path / "rows.jsonl"
    with pytest.raises(KeyboardInterrupt):
        parallel_map(interrupt_at_three, range(5), settings={}, out=out)
    done = []

    def notice(index):
        done.append(index)
        return square(index)

    rows = parallel_map(notice, range(6), settings={}, out=out, resume=True)
    assert done == [3, 4, 5]
    assert values(rows) == [0, 1, 4, 9, 16, 25]


@pytest.mark.parametrize("cut", [1, 5, 12])
def test_a_half_written_line_is_mended(tmp_path, cut):
    out = tmp_path / "rows.jsonl"
    parallel_map(square, range(3), settings={"a": 1}, out=out)
    whole = out.read_bytes()
    out.write_bytes(whole[:-cut])
    told = []
    rows = parallel_map(
        square, range(3), settings={"a": 1}, out=out, resume=True, progress=told.append
    )
    assert values(rows) == [0, 1, 4]
    assert told == [Progress(2, 3, 0), Progress(3, 3, 0)]
    assert out.read_bytes() == whole


def test_a_first_line_that_was_not_finished_begins_anew(tmp_path):
    out = tmp_path / "rows.jsonl"
    out.write_text('{"settings": {"a"')
    assert values(parallel_map(square, [2], settings={"a": 1}, out=out, resume=True)) == [4]
    assert json.loads(out.read_text().splitlines()[0]) == {"settings": {"a": 1}}


def test_failures_are_counted():
    told = []
    parallel_map(square_or_fail, range(4), settings={}, progress=told.append)
    assert [count.failed for count in told] == [0, 0, 1, 1, 2]


def test_what_is_finished_is_not_replaced(tmp_path):
    out = tmp_path / "rows.jsonl"
    parallel_map(square, [1], settings={}, out=out)
    with pytest.raises(InputError, match="exists already"):
        parallel_map(square, [1], settings={}, out=out)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"settings": {"a": 2, "b": 3}}\n', r"other settings \(a, b\)"),
        ('{"index": 0}\n', "line 1 holds no settings"),
        ('{"settings": {"a": 1}}\n{"index": 0\n', "line 2 cannot be read"),
        ('{"settings": {"a": 1}}\n[1]\n', "line 2 cannot be read"),
        ('{"settings": {"a": 1}}\n{"value": 1}\n', "line 2 has no index"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_and_kept(tmp_path, text, words):
    out = tmp_path / "rows.jsonl"
    out.write_text(text)
    with pytest.raises(InputError, match=words):
        parallel_map(square, [1], settings={"a": 1}, out=out, resume=True)
    assert out.read_text() == text


def test_what_cannot_be_sent_to_another_process_is_said():
    with pytest.raises(InputError, match="processes=1"):
        parallel_map(lambda index: {}, range(2), settings={}, processes=2)


def test_a_process_that_dies_does_not_hang(elsewhere):
    with pytest.raises(WorkError, match="died"):
        parallel_map(elsewhere.die, range(2), settings={}, processes=2)


def test_an_isolated_process_that_dies_leaves_the_others(elsewhere):
    rows = parallel_map(elsewhere.die_or_sleep, range(3), isolated=True, timeout=5.0)
    assert "exit status 1" in rows[0]["failed"]
    assert rows[1] == {"index": 1, "value": 1}
    assert "stopped after" in rows[2]["failed"]


def test_an_exception_in_another_process_is_raised(elsewhere):
    with pytest.raises(ZeroDivisionError) as caught:
        parallel_map(elsewhere.divide, range(2), settings={}, processes=2)
    assert "in divide" in caught.value.__notes__[0]


@pytest.mark.parametrize("processes", [0, True, 1.5])
def test_a_number_of_processes(processes):
    with pytest.raises(InputError, match="processes"):
        parallel_map(square, [1], settings={}, processes=processes)


def test_a_mistake_of_the_first_piece_leaves_nothing(tmp_path):
    def refuse(index):
        raise InputError("weather: there is no such setting.")

    out = tmp_path / "rows.jsonl"
    with pytest.raises(InputError, match="weather"):
        parallel_map(refuse, range(2), settings={}, out=out)
    assert not out.exists()
    parallel_map(square, range(1), settings={}, out=out)
    with pytest.raises(InputError, match="weather"):
        parallel_map(refuse, range(2), settings={}, out=out, resume=True)
    assert len(out.read_text().splitlines()) == 2
