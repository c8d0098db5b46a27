"""How far long work has come: a bar on a terminal, few lines elsewhere."""

import contextlib
import io

import pytest

from swarmssm.cli import progress as shown
from swarmssm.cli.progress import counting_progress, training_progress
from swarmssm.inference import TrainingProgress
from swarmssm.jobs import Progress


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


class Terminal(io.StringIO):
    """What is written to a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch):
    mine = Clock()
    monkeypatch.setattr(shown, "time", mine)
    return mine


@pytest.fixture
def on_terminal(monkeypatch):
    """Say what a terminal shows of some work."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")

    def shown_of(progress, now):
        terminal = Terminal()
        with contextlib.redirect_stderr(terminal), progress("work") as tell:
            tell(now)
        return terminal.getvalue()

    return shown_of


def at(epoch, total):
    return TrainingProgress(epoch=epoch, num_epochs=total, step=epoch, loss=0.5)


def test_lines_of_training_are_ten_seconds_apart(clock, capsys):
    with training_progress("fish") as tell:
        for epoch in range(1, 31):
            clock.now += 1.0
            tell(at(epoch, 30))
        tell(at(31, None))
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"fish: epoch {n} of 30, loss 0.5" for n in (10, 20, 30)]


def test_the_last_epoch_is_said_at_once(clock, capsys):
    with training_progress("fish") as tell:
        tell(at(1, 2))
        tell(at(2, 2))
    assert capsys.readouterr().err == "fish: epoch 2 of 2, loss 0.5\n"


def test_counting_says_where_it_begins_and_what_is_left(clock, capsys):
    with counting_progress("study") as tell:
        # 4 of 10 were done in an earlier run.
        tell(Progress(4, 10, 0))
        clock.now += 60.0
        tell(Progress(5, 10, 0))
        clock.now += 5.0
        tell(Progress(6, 10, 1))
        clock.now += 55.0
        tell(Progress(7, 10, 1))
        tell(Progress(10, 10, 1))
    assert capsys.readouterr().err.splitlines() == [
        "study: 4 of 10 data sets",
        # One a minute, and five to go.
        "study: 5 of 10 data sets, about 5 min left",
        # Three in two minutes, and three to go.
        "study: 7 of 10 data sets, 1 failed, about 2 min left",
        "study: 10 of 10 data sets, 1 failed",
    ]


def test_a_terminal_has_a_bar(on_terminal):
    seen = on_terminal(training_progress, at(3, 8))
    assert "3/8" in seen
    assert "loss 0.5" in seen


def test_a_bar_counts_failures(on_terminal):
    seen = on_terminal(counting_progress, Progress(3, 8, 2))
    assert "3/8" in seen
    assert "2 failed" in seen
