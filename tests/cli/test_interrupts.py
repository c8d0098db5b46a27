"""Ctrl-C: a sentence and status 1, no traceback, nothing half-written."""


def stop(*arguments, **options):
    raise KeyboardInterrupt


def test_a_stopped_fit_goes_on(swarmssm, flock_file, monkeypatch):
    from swarmssm.cli import fitting

    call = ("fit", flock_file, "--model", "graph-vae", "--out", "run", "--epochs", 2)
    with monkeypatch.context() as by_hand:
        # The first epoch is done when its progress is told.
        by_hand.setattr(fitting, "training_progress", StoppingProgress)
        stopped = swarmssm(*call)
    assert stopped.status == 1
    assert stopped.out == ""
    assert stopped.err == (
        "swarmssm: stopped by hand. The same call with --resume goes on from the last checkpoint, "
        "if there is one.\n"
    )
    done = swarmssm(*call, "--resume")
    assert done.status == 0, done.err
    assert "run: written" in done.out


class StoppingProgress:
    """Progress that is stopped as soon as it is told."""

    def __init__(self, label):
        pass

    def __enter__(self):
        return stop

    def __exit__(self, *error):
        return None


def test_any_other_command_that_is_stopped(swarmssm, run_folder, flock_file, tmp_path, monkeypatch):
    from swarmssm import io

    monkeypatch.setattr(io, "read", stop)
    stopped = swarmssm("analyze", run_folder, flock_file, "--out", "found.nc")
    assert stopped.status == 1
    assert stopped.out == ""
    assert stopped.err == "swarmssm: stopped by hand before the work was done.\n"
    assert not list(tmp_path.iterdir())
