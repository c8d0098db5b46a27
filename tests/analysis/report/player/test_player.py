"""The player holds the tracks to the resolution that it states, and stands well in any page."""

import base64
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from swarmssm.analysis.plots.scenes import scenes_of
from swarmssm.analysis.report import player
from swarmssm.analysis.report.player import (
    player_fragment,
    player_page,
)
from swarmssm.analysis.report.player_data import pack_scene, resolution_of
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

VOID = {"meta", "link", "input", "br"}


def unpack(packed):
    """Read the format back as the docstring of pack_scene tells it."""
    data = zlib.decompress(base64.b64decode(packed["bytes"]))
    frames, count = packed["frames"], len(packed["individuals"])
    size = count * 2 * frames
    bytes_ = np.frombuffer(data, np.uint8)
    change = bytes_[:size].astype(int) + 256 * bytes_[size : 2 * size].astype(int)
    numbers = np.cumsum(change.reshape(count, 2, frames), axis=-1) % 65536
    place = np.array(packed["offset"])[:, None] + packed["resolution"] * numbers
    place = np.where(numbers == 65535, np.nan, place)
    looks = bytes_[2 * size : 2 * size + count * frames].reshape(count, frames)
    angle = np.where(looks == 255, np.nan, looks.astype(float) * 2 * np.pi / 255)
    bits = np.unpackbits(bytes_[2 * size + count * frames :])
    graph = bits[: frames * count**2].reshape(frames, count, count) if packed["graph"] else None
    return place.transpose(2, 0, 1), angle.T, graph


class Checked(HTMLParser):
    """Reads HTML, and complains where tags do not match."""

    def __init__(self, text):
        super().__init__()
        self.open, self.found, self.words = [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append((self.open[-1] if self.open else "", data))

    def film(self):
        (text,) = [
            data
            for (tag, attrs), data in zip(
                [(t, a) for t, a in self.found if t == "script"],
                [d for t, d in self.words if t == "script" and d.strip()],
                strict=True,
            )
            if attrs.get("type") == "application/json"
        ]
        return json.loads(text)


@pytest.mark.parametrize("edges", [False, "k-nearest:2"])
def test_what_is_unpacked_is_what_was_packed(edges):
    generator = np.random.default_rng(0)
    position = generator.normal(0.0, 30.0, (40, 7, 2)).cumsum(axis=0)
    position += np.array([5e6, -4.0])
    position[3:9, 2] = np.nan
    position[:, 5] = np.nan
    position[0, 1] = np.nan
    (scene,) = scenes_of(make_tracks(position, fps=5), edges=edges)
    packed = json.loads(json.dumps(pack_scene(scene), allow_nan=False))
    place, angle, graph = unpack(packed)
    np.testing.assert_array_equal(np.isnan(place), np.isnan(position))
    # Half a step, and what the multiplication of numbers about 5e6 rounds.
    most = 0.5 * packed["resolution"] + 4 * np.spacing(5.1e6)
    assert np.nanmax(np.abs(place - position)) <= most
    span = np.nanmax(np.nanmax(position, axis=(0, 1)) - np.nanmin(position, axis=(0, 1)))
    assert packed["resolution"] == resolution_of(scene) == pytest.approx(span / 65534)
    np.testing.assert_array_equal(np.isnan(angle), np.isnan(scene.heading))
    off = np.angle(np.exp(1j * (angle - scene.heading)))
    assert np.nanmax(np.abs(off)) <= np.pi / 255 + 1e-12
    if edges:
        np.testing.assert_array_equal(graph, scene.adjacency)
    else:
        assert graph is None


def test_who_stands_still_or_is_never_there_can_be_packed():
    position = np.full((3, 2, 2), 7.0)
    position[:, 1] = np.nan
    (scene,) = scenes_of(make_tracks(position, fps=1))
    place, angle, _ = unpack(pack_scene(scene))
    np.testing.assert_array_equal(place, position)
    assert np.isnan(angle).all()


def square(frames=5, **more):
    """Four at the corners of a square that moves right, two of them seeing each other."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    position = corners + np.arange(frames)[:, None, None] * [1.0, 0.0]
    graph = np.zeros((frames, 4, 4))
    graph[:, 0, 1] = graph[:, 1, 0] = 1
    more = {"fps": 10, "adjacency": graph, "unit": "cm"} | more
    return make_tracks(position, **more)


def test_a_page_holds_both_tracks_and_says_how_well():
    text = player_page(square(), square(3), title="School", titles=("Seen", "Guessed")).html()
    page = Checked(text)
    film = page.film()
    assert [len(one["individuals"]) for one in film["scenes"]] == [4, 4]
    place, _, graph = unpack(film["scenes"][0])
    half = film["scenes"][0]["resolution"] / 2
    np.testing.assert_allclose(
        place, square()["position"].transpose("time", "individual", "space"), atol=half
    )
    assert graph.sum() == 10
    assert np.isnan(unpack(film["scenes"][1])[0][3:]).all()
    assert (film["frames"], film["first"], film["pace"]) == (5, 0.0, 10.0)
    assert film["step"] == pytest.approx(0.1)
    assert film["scenes"][0]["colours"] == film["scenes"][1]["colours"]
    words = " ".join(data for _, data in page.words)
    assert f"Positions are kept to within {half:.2g} cm." in words
    assert "Seen" in words
    assert "Guessed" in words
    labels = [attrs["aria-label"] for tag, attrs in page.found if tag == "canvas"]
    assert labels[0] == "Seen: 4 individuals, trial 0, 5 frames from 0 s to 0.4 s"
    assert ("html", {"lang": "en"}) in page.found


def test_a_page_may_not_use_the_network_and_does_not_try():
    text = player_page(square()).html()
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
    assert policy.startswith("default-src 'none'")
    outside = re.sub(r"<script type=.application/json.>.*?</script>", "", text, flags=re.S)
    assert not re.search(r"https?:|//[a-z]|@import|\burl\(", outside)


def test_a_fragment_has_no_names():
    body = player_fragment(square(), label="One & only")
    page = Checked(body)
    assert not [tag for tag, attrs in page.found if "id" in attrs or "for" in attrs]
    assert page.found[0][1]["aria-label"] == "One & only"
    assert "<style>" not in body
    assert not page.film()["autoplay"]


def test_controls_follow_what_there_is():
    def parts(*arguments, **options):
        page = Checked(player_fragment(*arguments, **options))
        return [attrs["data-part"] for _, attrs in page.found if "data-part" in attrs]

    everything = ["play", "scrub", "clock", "speed", "edges", "tails", "names"]
    assert parts(square()) == everything
    assert "edges" not in parts(square(), edges=False)
    assert "tails" not in parts(square(), tail=0)


def test_hostile_names_stay_text():
    evil = "</script><script>alert('&')</script>"
    tracks = square(individuals=[f"{evil}{k}" for k in range(4)], unit=evil)
    text = player_page(tracks, title=evil, titles=(evil, evil)).html()
    page = Checked(text)
    assert [tag for tag, _ in page.found].count("script") == 2
    assert page.film()["unit"] == evil
    assert page.film()["scenes"][0]["individuals"][0] == f"{evil}0"


def test_speeds_are_told_beside_that_of_the_recording():
    def speeds(**options):
        page = Checked(player_fragment(square(), **options))
        return [data for tag, data in page.words if tag == "option"]

    assert speeds() == ["0.25×", "0.5×", "1×", "2×", "4×", "8×"]
    # Five frames a second of what had ten: half as fast at the least factor that changes nothing.
    assert speeds(fps_out=5)[2] == "0.5×"
    assert speeds(every=2)[2] == "1×"


def test_what_a_reader_has_to_know_is_said():
    deep = make_tracks(np.random.default_rng(0).normal(size=(5, 4, 3)), fps=10)
    far = square()
    far["position"][4, 0] = 1e4
    words = " ".join(data for _, data in Checked(player_fragment(deep, far)).words)
    assert "z is not shown" in words
    assert "Some positions of “Predicted” lie outside of the picture." in words


def test_what_would_open_slowly_is_refused(monkeypatch):
    monkeypatch.setattr(player, "MAX_BYTES", 10)
    with pytest.raises(InputError, match="5 frames of 4 individuals make a page of more than"):
        player_page(square()).html()
    with pytest.raises(InputError, match="tail: it must be at least 0, and it is -2"):
        player_page(square(), tail=-2).html()


def test_much_takes_little():
    """A thousand frames of ten individuals, with their graph, are below 100 kB."""
    generator = np.random.default_rng(0)
    path = generator.normal(size=(1000, 10, 2)).cumsum(axis=0)
    assert len(player_page(make_tracks(path, fps=10), edges="k-nearest:3").html()) < 100_000
