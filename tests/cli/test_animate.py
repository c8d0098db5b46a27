"""``swarmssm animate``: a player or a film of tracks, a free run beside them."""

import json
import re

import pytest
from matplotlib.animation import writers
from PIL import Image


def film_of(path):
    """Return what a player's page holds."""
    text = path.read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', text, flags=re.S)
    return json.loads(data)


def test_a_player_of_tracks(swarmssm, flock_file, tmp_path):
    done = swarmssm("animate", flock_file, "--out", "w.html", "--trial", "1")
    assert (done.status, done.err) == (0, "")
    assert done.out == f"w.html: written. It shows the tracks of {flock_file}.\n"
    film = film_of(tmp_path / "w.html")
    assert film["frames"] == 60
    (scene,) = film["scenes"]
    assert scene["individuals"] == ["0", "1", "2", "3", "4"]
    # The tracks carry their graph.
    assert scene["graph"]
    assert "<h1>Tracks of flock.nc</h1>" in (tmp_path / "w.html").read_text(encoding="utf-8")


def test_what_is_shown_can_be_chosen(swarmssm, flock_file, tmp_path):
    done = swarmssm(
        *("animate", flock_file, "--out", "w.html", "--start", 2, "--steps", 20, "--every", 4),
        *("--individuals", "1, 3", "--edges", "none", "--tail", 7, "--fps-out", 5),
    )
    assert done.status == 0
    film = film_of(tmp_path / "w.html")
    assert (film["frames"], film["tail"], film["pace"]) == (6, 7, 5.0)
    assert film["first"] == pytest.approx(2.0)
    (scene,) = film["scenes"]
    assert scene["individuals"] == ["1", "3"]
    assert not scene["graph"]
    swarmssm("animate", flock_file, "--out", "e.html", "--edges", "k-nearest:2")
    assert film_of(tmp_path / "e.html")["scenes"][0]["graph"]


def test_a_free_run_stands_beside_the_tracks(swarmssm, flock_file, run_folder, tmp_path):
    def show(out, *options):
        done = swarmssm(
            *("animate", flock_file, "--out", out, "--run", run_folder),
            *("--trial", "0", "--start", 3, "--steps", 10, *options),
        )
        assert (done.status, done.err) == (0, "")
        assert "from 3 s, beside them a free run of graph-vae." in done.out
        return film_of(tmp_path / out)

    film = show("w.html")
    observed, predicted = film["scenes"]
    assert film["frames"] == observed["frames"] == predicted["frames"] == 11
    assert film["first"] == pytest.approx(3.0)
    assert predicted["graph"]
    assert "Free run of graph-vae" in (tmp_path / "w.html").read_text(encoding="utf-8")
    assert show("same.html") == film
    assert show("other.html", "--seed", 1)["scenes"][0] == observed
    assert show("third.html", "--seed", 1)["scenes"][1] != predicted
    calm = [show(f"calm{k}.html", "--no-noise", "--seed", k)["scenes"][1] for k in range(2)]
    assert calm[0] == calm[1] != predicted


def test_a_gif_of_tracks(swarmssm, flock_file, run_folder, tmp_path):
    asked = ("animate", flock_file, "--run", run_folder, "--start", 3, "--steps", 4)
    done = swarmssm(*asked, "--out", "w.gif")
    assert done.status == 0, done.err
    assert done.err.endswith("w.gif: 5 of 5 frames\n")
    with Image.open(tmp_path / "w.gif") as film:
        assert film.n_frames == 5
        # Boids at ten frames a second.
        assert film.info["duration"] == 100
    again = swarmssm(*asked, "--out", "w.gif")
    assert again.status == 2
    assert "exists already and was left as it is" in again.err
    assert swarmssm(*asked, "--out", "w.gif", "--overwrite").status == 0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--out", "w.avi"), "w.avi: its ending says what to write; it must be .html, .gif or"),
        (("--out", "w"), "w: its ending says what to write"),
        (("--out", "none/w.html"), "the folder none does not exist"),
        (("--out", "w.html", "--individuals", "0,z"), "individuals: there is no 'z'; there are 0,"),
        (("--out", "w.html", "--start", "99"), "start: 99 s lies outside of the tracks"),
        (("--out", "w.html", "--trial", "z"), "there is no trial 'z'; there are 0, 1, 2"),
        (("--out", "w.html", "--edges", "magic"), "graph: the kind 'magic' is unknown"),
        (("--out", "w.gif", "--fps-out", "0"), "fps_out: it must be a positive number"),
        (("--out", "w.html", "--run", "none"), "none"),
    ],
)
def test_mistakes_are_told(swarmssm, flock_file, tmp_path, options, sentence):
    done = swarmssm("animate", flock_file, *options)
    assert done.status == 2
    assert done.err.startswith("swarmssm: ")
    assert sentence in done.err
    assert not list(tmp_path.iterdir())


def test_a_run_needs_something_to_go_on_from(swarmssm, flock_file, run_folder):
    done = swarmssm("animate", flock_file, "--run", run_folder, "--out", "w.html", "--start", 0)
    assert done.status == 2
    assert "a free run needs two frames to go on from" in done.err


def test_without_ffmpeg_nothing_is_begun(swarmssm, flock_file, monkeypatch):
    monkeypatch.setattr(writers, "is_available", lambda name: name != "ffmpeg")
    done = swarmssm("animate", flock_file, "--out", "w.mp4", "--run", "none")
    assert done.status == 2
    assert "matplotlib's mp4 writer needs the program ffmpeg" in done.err
