"""Films show the frames they should, at their pace, and are written whole or not at all."""

import itertools
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib.animation import FuncAnimation, writers
from matplotlib.figure import Figure
from PIL import Image

from swarmssm.analysis.plots import animation as films
from swarmssm.analysis.plots.animation import check_film, write_animation
from swarmssm.errors import InputError, WorkError
from swarmssm.tracks import make_tracks


def right(frames=12, fps=10.0, start=0.0, speed=1.0):
    """Two that go right, at y = 0 and y = 5."""
    position = np.zeros((frames, 2, 2))
    position[..., 0] = speed * np.arange(frames)[:, None]
    position[:, 1, 1] = 5.0
    return make_tracks(position, time=start + np.arange(frames) / fps, fps=fps, unit="cm")


def animate(*arguments, **options):
    """Animate, without matplotlib's warning where nothing is drawn in the end."""
    animation = films.animate(*arguments, **options)
    animation._draw_was_started = True
    return animation


def frame(animation, number):
    """Draw a frame; return the figure's axes."""
    animation._draw_frame(number)
    return animation._fig.axes


def places(ax):
    bodies = ax.collections[-1]
    return np.array([path.vertices[[0, 2]].mean(axis=0) for path in bodies.get_paths()])


def test_each_frame_shows_its_time_and_its_places():
    animation = animate(right(), right(speed=0.5), titles=("seen", "guessed"))
    assert isinstance(animation, FuncAnimation)
    one, other = frame(animation, 7)
    assert one.get_title() == "seen, 0.7 s"
    assert other.get_title() == "guessed, 0.7 s"
    middle = 0.2 * 0.028 * 11 * 1.1
    np.testing.assert_allclose(places(one)[:, 1], [0.0, 5.0], atol=1e-12)
    np.testing.assert_allclose(places(one)[:, 0], 7.0, atol=2 * middle)
    np.testing.assert_allclose(places(other)[:, 0], 3.5, atol=2 * middle)
    assert one.get_xlim() == other.get_xlim()
    # What the writers count: a frame for each, at the pace of the recording.
    assert list(animation.new_frame_seq()) == list(range(12))
    assert animation._interval == pytest.approx(100.0)


def test_what_is_chosen_is_shown():
    animation = animate(right(), start=0.2, steps=6, every=3, individuals=["1"], fps_out=7)
    (ax,) = frame(animation, 2)
    assert ax.get_title() == "observed, 0.8 s"
    assert len(places(ax)) == 1
    assert list(animation.new_frame_seq()) == [0, 1, 2]
    assert animation._interval == pytest.approx(1000 / 7)
    # A tenth of a second of three frames is no longer the pace of the recording.
    assert "2.1 times as fast" in animation._fig._supxlabel.get_text()
    frame(animation, 0)


def test_a_gif_has_every_frame_and_keeps_the_pace(tmp_path):
    animation = animate(right(frames=7, fps=30.0), tail=2)
    path = write_animation(animation, tmp_path / "w.gif", dpi=50)
    with Image.open(path) as film:
        assert film.format == "GIF"
        assert film.n_frames == 7
        lengths = []
        pictures = []
        for number in range(7):
            film.seek(number)
            lengths.append(film.info["duration"])
            pictures.append(np.asarray(film.convert("RGB")))
        assert film.info["loop"] == 0
    # A thirtieth of a second is 3.33 hundredths: what is rounded at one is made up for at another.
    assert set(lengths) == {30, 40}
    assert sum(lengths) == 230
    assert all((a != b).any() for a, b in itertools.pairwise(pictures))
    assert [p.name for p in tmp_path.iterdir()] == ["w.gif"]


def test_another_animation_of_matplotlib_is_written_too(tmp_path):
    figure = Figure(figsize=(1, 1))
    (line,) = figure.subplots().plot([0, 1], [0, 1])
    animation = FuncAnimation(figure, lambda k: line.set_ydata([0, k]), frames=3, interval=200)
    seen = []
    write_animation(
        animation, tmp_path / "w.gif", progress=lambda now: seen.append((now.done, now.total))
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
    with Image.open(tmp_path / "w.gif") as film:
        assert film.n_frames == 3


def test_a_film_that_is_there_is_left_as_it_is(tmp_path):
    path = tmp_path / "w.gif"
    path.write_text("mine")
    animation = animate(right(frames=2))
    with pytest.raises(InputError, match="exists already"):
        write_animation(animation, path)
    assert path.read_text() == "mine"
    write_animation(animation, path, dpi=30, overwrite=True)
    assert path.read_bytes()[:3] == b"GIF"


def test_without_ffmpeg_mp4_is_refused_with_the_mend(tmp_path, monkeypatch):
    monkeypatch.setattr(writers, "is_available", lambda name: name != "ffmpeg")
    with pytest.raises(InputError, match=r"needs the program ffmpeg, which is not installed.*gif"):
        check_film(tmp_path / "w.mp4")
    assert check_film(tmp_path / "w.gif")
    with pytest.raises(InputError, match=r"a film is a .gif or .mp4 file"):
        check_film(tmp_path / "w.avi")


def test_an_mp4_has_every_frame(tmp_path):
    if shutil.which("ffmpeg") is None:
        pytest.skip("no mp4: ffmpeg is not installed")
    path = write_animation(animate(right(frames=9)), tmp_path / "w.mp4", dpi=50)
    read = ["ffmpeg", "-v", "error", "-i", str(path), "-f", "null", "-progress", "-", "-"]
    done = subprocess.run(read, capture_output=True, text=True, check=True)
    assert "frame=9\n" in done.stdout
    assert "progress=end" in done.stdout


def test_an_ffmpeg_that_fails_is_told(tmp_path, monkeypatch):
    class Failing(films._GifWriter):
        def __init__(self, fps, extra_args):
            assert extra_args[:2] == ["-f", "mp4"]
            super().__init__(fps)

        def finish(self):
            raise subprocess.CalledProcessError(7, "ffmpeg")

    monkeypatch.setitem(writers._registered, "ffmpeg", Failing)
    with pytest.raises(WorkError, match="ffmpeg failed with status 7"):
        write_animation(animate(right(frames=2)), tmp_path / "w.mp4", dpi=30)
    assert not list(tmp_path.iterdir())


def test_too_long_or_too_fast_for_a_gif(tmp_path, monkeypatch):
    monkeypatch.setattr(films, "MAX_GIF", 3)
    with pytest.raises(InputError, match="a gif has at most 3 frames"):
        write_animation(animate(right(frames=5)), tmp_path / "w.gif", dpi=30)
    with pytest.raises(InputError, match="a gif shows at most 100 frames a second, not 200"):
        write_animation(animate(right(frames=2), fps_out=200), tmp_path / "w.gif")
    assert not list(tmp_path.iterdir())


def test_what_a_reader_has_to_know_stands_below():
    deep = np.random.default_rng(0).normal(size=(4, 2, 3))
    animation = animate(make_tracks(deep, fps=5), right(frames=4, fps=5.0, speed=99.0))
    text = animation._fig._supxlabel.get_text()
    assert "z is not shown" in text
    assert "Some predicted positions lie outside of the picture." in text
    frame(animation, 0)
    with pytest.raises(InputError, match="tail: it must be at least 0"):
        animate(right(), tail=-1)
