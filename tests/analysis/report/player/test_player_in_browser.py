"""The player in Chromium: it plays, keys and mouse work, and it shows what the tracks hold."""

import time

import numpy as np
import pytest

from swarmssm.analysis.report.page import Page, Player
from swarmssm.analysis.report.player import player_fragment, player_page
from swarmssm.tracks import make_tracks

FRAMES = 50


@pytest.fixture(scope="module")
def tracks():
    """Three that go right, 1 a frame, 3 apart; the third is lost in frames 10 to 19."""
    position = np.zeros((FRAMES, 3, 2))
    position[..., 0] = np.arange(FRAMES)[:, None]
    position[..., 1] = [0.0, 3.0, 6.0]
    position[10:20, 2] = np.nan
    graph = np.zeros((FRAMES, 3, 3))
    graph[:, 0, 1] = graph[:, 1, 2] = graph[:, 2, 1] = 1
    return make_tracks(position, fps=25, adjacency=graph, unit="cm", individuals=["a", "b", "c"])


def ready(page):
    page.wait_for_selector(".swarm-player[data-state=ready]")
    return page


def frame_of(page, number=0):
    return page.evaluate(f"document.querySelectorAll('.swarm-player')[{number}].player.frame")


def playing(page, number=0):
    return page.evaluate(f"document.querySelectorAll('.swarm-player')[{number}].player.playing")


def wait_until(page, condition):
    """Wait until it is true of the first player p; the page's policy forbids Playwright's way."""
    ends = time.monotonic() + 60
    while not page.evaluate(f"(p => {condition})(document.querySelector('.swarm-player').player)"):
        assert time.monotonic() < ends, f"never came true: {condition}"
        page.wait_for_timeout(20)


def test_it_plays_by_itself_and_stops_when_told(visit, tracks):
    page = ready(visit(player_page(tracks).html()))
    wait_until(page, "p.playing && p.frame > 0")
    play = page.get_by_role("button")
    assert "Pause" in play.inner_text()
    play.click()
    assert not playing(page)
    assert "Play" in play.inner_text()
    stopped = frame_of(page)
    page.wait_for_timeout(200)
    assert frame_of(page) == stopped
    # After the last frame comes the first.
    page.evaluate(f"document.querySelector('.swarm-player').player.seek({FRAMES - 2})")
    play.click()
    wait_until(page, f"p.frame < {FRAMES - 2}")


def test_who_prefers_less_motion_starts_it(visit, tracks):
    page = ready(visit(player_page(tracks).html(), reduced_motion="reduce"))
    page.wait_for_timeout(200)
    assert not playing(page)
    assert frame_of(page) == 0
    page.get_by_role("button").click()
    wait_until(page, "p.frame > 0")


def test_keys_do_what_they_say(visit, tracks):
    page = ready(visit(player_page(tracks, autoplay=False).html()))
    press = page.keyboard.press
    press("ArrowRight")
    press("ArrowRight")
    assert frame_of(page) == 2
    press("ArrowLeft")
    press("Shift+ArrowRight")
    assert frame_of(page) == 11
    press("End")
    assert frame_of(page) == FRAMES - 1
    press("ArrowRight")
    assert frame_of(page) == FRAMES - 1
    press("Home")
    assert frame_of(page) == 0
    press(" ")
    wait_until(page, "p.playing && p.frame > 0")
    press(" ")
    assert not playing(page)
    # The tab key reaches all controls, in their order, and shows where it is.
    reached = []
    for _ in range(6):
        press("Tab")
        reached.append(
            page.evaluate("document.activeElement.dataset.part ?? document.activeElement.tagName")
        )
        outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
        assert outline != "none"
    assert reached == ["play", "scrub", "speed", "edges", "tails", "names"]
    # On the first control the space bar is the button's own, and plays once, not twice.
    page.locator("[data-part=play]").focus()
    press(" ")
    assert playing(page)
    press(" ")
    assert not playing(page)
    page.locator("[data-part=scrub]").focus()
    now = frame_of(page)
    press("ArrowRight")
    assert frame_of(page) == (now + 1 if now < FRAMES - 1 else now)
    scrub = page.locator("[data-part=scrub]")
    assert scrub.get_attribute("aria-valuetext").endswith(f"of {FRAMES}")


def test_it_shows_what_the_tracks_hold(visit, tracks):
    page = ready(visit(player_page(tracks, tracks.isel(time=slice(0, 30)), autoplay=False).html()))
    held = page.evaluate(
        """() => document.querySelector('.swarm-player').player.scenes.map((scene) => ({
            places: Array.from({length: scene.frames}, (_, frame) =>
                scene.names.map((_, one) => scene.at(frame, one))),
            looks: scene.names.map((_, one) => scene.heading(5, one)),
            graph: scene.names.map((_, one) => scene.names.map((_, other) =>
                scene.sees(15, one, other))),
        }))"""
    )
    expected = tracks["position"].transpose("time", "individual", "space").to_numpy()
    half = (FRAMES - 1) / 65534 / 2 + 1e-12
    for scene, frames in zip(held, (FRAMES, 30), strict=True):
        for frame, places in enumerate(scene["places"]):
            for one, place in enumerate(places):
                if frame >= frames or (one == 2 and 10 <= frame < 20):
                    assert place is None
                else:
                    np.testing.assert_allclose(place, expected[frame, one], atol=half)
        assert scene["looks"] == [0.0, 0.0, 0.0]
        # In frame 15 the third is not tracked, so that nobody sees it.
        assert scene["graph"] == [[False, True, False], [False] * 3, [False] * 3]


def ink(page):
    """Count the pixels of the first canvas that are drawn on."""
    return page.evaluate(
        """() => {
            const drawn = document.querySelector('canvas');
            const copy = new OffscreenCanvas(drawn.width, drawn.height);
            const pen = copy.getContext('2d', {willReadFrequently: true});
            pen.drawImage(drawn, 0, 0);
            const pixels = pen.getImageData(0, 0, drawn.width, drawn.height).data;
            return pixels.filter((value, place) => place % 4 === 3 && value > 0).length;
        }"""
    )


def test_edges_tails_and_names_go_on_and_off(visit, tracks):
    page = ready(visit(player_page(tracks, autoplay=False).html()))
    page.evaluate("document.querySelector('.swarm-player').player.seek(30)")
    full = ink(page)
    for name in ("Edges", "Tails"):
        page.get_by_label(name).uncheck()
        less = ink(page)
        assert 0 < less < full
        full = less
    page.get_by_label("Names").check()
    assert ink(page) > full


def test_it_goes_faster_when_told(visit, tracks):
    page = ready(visit(player_page(tracks, autoplay=False, fps_out=0.5).html()))
    page.get_by_label("Speed").select_option("8")
    page.get_by_role("button").click()
    # At 8 times half a frame a second one takes a quarter of a second, at once it took two.
    wait_until(page, "p.frame >= 2")


def test_several_stand_on_one_page(visit, tracks):
    players = [Player(name, "", player_fragment(tracks, label=name)) for name in ("One", "Two")]
    page = ready(visit(Page("Both", players).html()))
    page.locator(".swarm-player[data-state=ready]").nth(1).wait_for()
    page.get_by_role("group", name="Two").get_by_role("button").click()
    ends = time.monotonic() + 60
    while frame_of(page, 1) == 0:
        assert time.monotonic() < ends
        page.wait_for_timeout(20)
    assert frame_of(page, 0) == 0
    assert not playing(page, 0)
    assert playing(page, 1)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_telephone_light_and_dark(visit, tracks, scheme):
    narrow = {"width": 420, "height": 800}
    page = ready(
        visit(
            player_page(tracks, tracks, autoplay=False).html(), viewport=narrow, color_scheme=scheme
        )
    )
    assert page.evaluate("document.documentElement.scrollWidth") == 420
    ground, text = page.evaluate(
        """() => ['backgroundColor', 'color'].map((name) =>
            getComputedStyle(document.querySelector(name === 'color' ? 'h1' : 'canvas'))[name])"""
    )

    def brightness(colour):
        return sum(int(part) for part in colour[4:-1].split(",")[:3])

    assert (brightness(ground) > brightness(text)) == (scheme == "light")
    for box in [control.bounding_box() for control in page.locator("button, select").all()]:
        assert box["height"] >= 40


def test_a_browser_that_cannot_unpack_says_so(browser, tmp_path, tracks):
    file = tmp_path / "page.html"
    file.write_text(player_page(tracks).html(), encoding="utf-8")
    context = browser.new_context()
    context.add_init_script("delete window.DecompressionStream")
    page = context.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("[data-state=failed]")
    assert "it has to know DecompressionStream" in page.inner_text("output")
    context.close()
