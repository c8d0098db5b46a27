"""Hold the visual field against configurations worked out by hand and a slow ray caster."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import swarmssm
from swarmssm import graphs, io
from swarmssm.errors import InputError
from swarmssm.graphs import headings_from_velocity, visual, visual_field_graph

NAN = math.nan
EAST, NORTH, WEST = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)


def see(places, headings, **anatomy):
    """Return the edges among bodies of length 1 and width 0.25."""
    graph = visual_field_graph(
        torch.tensor(places, dtype=torch.float64),
        torch.tensor(headings, dtype=torch.float64),
        **{"body_length": 1.0, **anatomy},
    )
    return {tuple(pair) for pair in graph.nonzero().tolist()}


def test_the_middle_one_hides_the_last():
    """Three in a row, all looking along it.

    The eyes of 0 lie at (0.35, +-0.09). Tangents from them to the body of 1, whose edge is 0.125
    off the row at x = 3, pass x = 6 at 0.16 or more off the row, and 2 is only 0.125 wide. Behind
    1 and 2 the others lie within the blind angle.
    """
    row = [[0, 0], [3, 0], [6, 0]]
    assert see(row, [EAST] * 3) == {(0, 1), (1, 2)}
    # Without the middle one, or a body's width beside the row, the last is seen.
    assert see([[0, 0], [NAN, NAN], [6, 0]], [EAST] * 3) == {(0, 2)}
    assert see([[0, 0], [3, 0], [6, 0.5]], [EAST] * 3) == {(0, 1), (0, 2), (1, 2)}


def test_a_body_hides_more_from_its_side_than_from_its_end():
    """Towards (6, 0.6), past a body at (3, 0).

    Along the row that body is 0.125 wide to each side, and the line from the left eye over it
    passes x = 6 at 0.17, that from the right eye at 0.37: the last one, from 0.475 to 0.725, is
    free. Across the row it is 0.5 wide: the lines pass at 0.97 and more, and the last is hidden.
    """
    places = [[0, 0], [3, 0], [6, 0.6]]
    assert (0, 2) in see(places, [EAST, EAST, EAST])
    assert (0, 2) not in see(places, [EAST, NORTH, EAST])


def test_the_blind_angle_behind():
    """Two swim apart, each 28 degrees off straight behind the other's eyes, 3 degrees wide."""
    behind = [-5 * math.cos(math.radians(30)), 5 * math.sin(math.radians(30))]
    places, headings = [[0, 0], behind], [EAST, WEST]
    assert see(places, headings) == {(0, 1), (1, 0)}
    assert see(places, headings, blind_angle=45.0) == {(0, 1), (1, 0)}
    assert see(places, headings, blind_angle=75.0) == set()
    straight = [[0, 0], [-5, 0]]
    assert see(straight, headings) == set()
    assert see(straight, headings, blind_angle=0.0) == {(0, 1), (1, 0)}
    assert see(straight, headings, blind_angle=0.0, eyes=1) == {(0, 1), (1, 0)}


def test_sight_is_not_mutual():
    """The follower sees the leader, the leader not the follower."""
    assert see([[0, 0], [4, 0]], [EAST, EAST]) == {(0, 1)}


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_one_eye_field_ends_across_the_front(side):
    """Eyes of 100 degrees and a blind angle of 160: each sees from straight ahead to its side."""
    places = [[0, 0], [4, side * 3], [-2, side * 4]]
    assert see(places, [EAST] * 3, blind_angle=160.0, eye_field=100.0) >= {(0, 1)}
    assert (0, 2) not in see(places, [EAST] * 3, blind_angle=160.0, eye_field=100.0)
    # Eyes of 50 degrees leave the 100 degrees in front blind: (4, 3) is 39.5 degrees off the eye.
    assert (0, 1) not in see(places, [EAST] * 3, blind_angle=160.0, eye_field=50.0)


def test_two_eyes_see_past_what_hides_from_one():
    """Discs of diameter 1: 0 at the origin, one at (2, 0), one at (8, 1.6).

    From the midline, (0.35, 0), the near disc spans 17.6 degrees to each side and the far one 8.2
    to 15.5 degrees: hidden. From the left eye, (0.35, 0.36), the near disc ends at 5.0 degrees, and
    the far one begins at 5.5.
    """
    places = [[0, 0], [2, 0], [8, 1.6]]
    assert (0, 2) not in see(places, [EAST] * 3, body_width=1.0, eyes=1)
    assert (0, 2) in see(places, [EAST] * 3, body_width=1.0, eyes=2)


def test_the_reach_of_a_ray():
    """From the eye at 0.35 to the tail at 2.5 it is 2.15 straight ahead."""
    places, headings = [[0, 0], [3, 0]], [EAST, EAST]
    alone = {"eyes": 1, "rays": 513}  # the middle ray looks straight ahead
    assert see(places, headings, max_distance=2.1501, **alone) == {(0, 1)}
    assert see(places, headings, max_distance=2.1499, **alone) == set()


def test_a_body_between_two_rays_is_not_seen():
    """Three rays at -90, 0 and 90 degrees: what lies at 45 degrees is missed."""
    places = [[0, 0], [5, 5], [5, 0]]
    few = {"eyes": 1, "blind_angle": 180.0}
    assert see(places, [EAST] * 3, rays=3, **few) & {(0, 1), (0, 2)} == {(0, 2)}
    assert see(places, [EAST] * 3, rays=300, **few) >= {(0, 1), (0, 2)}


def test_an_eye_inside_bodies_sees_these_bodies_alone():
    places = [[0, 0], [0.4, 0.1], [5, 0], [0.3, 0.0]]
    headings = [EAST, NORTH, WEST, NORTH]
    assert {j for i, j in see(places, headings, body_width=0.9) if i == 0} == {1, 3}


def test_who_has_no_heading_sees_nobody_but_hides():
    """A disc of the same area has the radius 0.5 * sqrt(1 * 0.25) = 0.25.

    Past it the line from the left eye, at 0.09, passes x = 6 at 0.43 and hides the last one, from
    0.125 to 0.375. Past a body along the row, half as wide, it passes at 0.17.
    """
    places = [[0, 0], [3, 0], [6, 0.25]]
    assert see(places, [EAST, (NAN, NAN), EAST]) == {(0, 1)}
    assert see(places, [EAST, (0.0, 0.0), EAST]) == {(0, 1)}
    assert see(places, [EAST, EAST, EAST]) >= {(0, 1), (0, 2)}


def test_an_absent_individual_neither_sees_nor_is_seen():
    assert see([[NAN, NAN], [3, 0]], [EAST, WEST]) == set()
    assert see([[NAN, 0.0], [NAN, 0.0]], [EAST, WEST]) == set()
    assert see([[0.0, 0.0]], [EAST]) == set()


def focal_distance(x, y, foci):
    """Return the sum of the distances to both foci."""
    (ax, ay), (bx, by) = foci
    return math.hypot(x - ax, y - ay) + math.hypot(x - bx, y - by)


def cast(origin, angle, center, heading, length, width):
    """Return where a ray meets an ellipse, or infinity; by the sum of the distances to its foci.

    Along a ray that sum is convex: its least value is found by ternary search, and the border,
    where the sum is the length of the body, by bisection before that.
    """
    c = 0.5 * math.sqrt(length**2 - width**2)
    foci = [(center[0] + s * c * heading[0], center[1] + s * c * heading[1]) for s in (1, -1)]
    dx, dy = math.cos(angle), math.sin(angle)

    def along(t):
        """Return the sum at distance t."""
        return focal_distance(origin[0] + t * dx, origin[1] + t * dy, foci) - length

    if along(0.0) <= 0:
        return 0.0
    low, high = 0.0, 1e3
    for _ in range(100):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, b) if along(a) < along(b) else (a, high)
    if along(low) > 0:
        return math.inf
    near, far = 0.0, low
    for _ in range(60):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if along(middle) > 0 else (near, middle)
    return near


def slow_visual_field(places, headings, length, width, blind, field, eyes, rays):
    """Cast every ray of every eye on every body, one by one."""
    seen = set()
    for i, (place, heading) in enumerate(zip(places, headings, strict=True)):
        looks = math.atan2(heading[1], heading[0])
        clear = math.radians(360 - blind)
        span = clear if eyes == 1 else min(math.radians(field), clear)
        for side in (0,) if eyes == 1 else (1, -1):
            # An eye at (0.35 length, y) on the outline: (0.7)^2 + (y / half width)^2 = 1.
            across = side * math.sqrt(1 - 0.49) * width / 2
            origin = (
                place[0] + 0.35 * length * math.cos(looks) - across * math.sin(looks),
                place[1] + 0.35 * length * math.sin(looks) + across * math.cos(looks),
            )
            axis = looks + side * (clear - span) / 2
            for angle in np.linspace(axis - span / 2, axis + span / 2, rays):
                hits = [
                    (cast(origin, angle, places[j], headings[j], length, width), j)
                    for j in range(len(places))
                    if j != i
                ]
                nearest = min(hits)[0]
                if nearest < math.inf:
                    seen |= {(i, j) for distance, j in hits if distance == nearest}
    return seen


@pytest.mark.parametrize(
    ("eyes", "blind", "field", "spread"),
    [
        (2, 30.0, 260.0, 6.0),
        (2, 0.0, 260.0, 3.0),
        (2, 200.0, 90.0, 6.0),
        (2, 220.0, 260.0, 6.0),
        (1, 90.0, 260.0, 6.0),
    ],
)
def test_agrees_with_a_slow_ray_caster(eyes, blind, field, spread):
    """Crowds of 6 in a square of side 6, or 3 where bodies overlap; 40 rays leave many unseen."""
    generator = np.random.default_rng(int(blind) + eyes)
    places = generator.uniform(0, spread, (3, 6, 2))
    angles = generator.uniform(0, 2 * np.pi, (3, 6))
    headings = np.stack([np.cos(angles), np.sin(angles)], -1)
    graph = visual_field_graph(
        torch.from_numpy(places),
        torch.from_numpy(2.5 * headings),
        body_length=1.2,
        body_width=0.5,
        blind_angle=blind,
        eye_field=field,
        eyes=eyes,
        rays=40,
    )
    for frame, p, h in zip(graph, places, headings, strict=True):
        expected = slow_visual_field(p.tolist(), h.tolist(), 1.2, 0.5, blind, field, eyes, 40)
        assert {tuple(pair) for pair in frame.nonzero().tolist()} == expected


def crowd(frames=20, members=15, spread=8.0):
    generator = torch.Generator().manual_seed(7)
    draw = {"dtype": torch.float64, "generator": generator}
    places = spread * torch.rand(frames, members, 2, **draw)
    return places, torch.randn(frames, members, 2, **draw)


def test_does_not_depend_on_the_frame_of_reference():
    """Turned, moved, mirrored, scaled and relabelled crowds see the same."""
    places, headings = crowd()
    graph = visual_field_graph(places, headings, body_length=1.0)
    assert 0 < graph.double().mean() < 0.9  # some are hidden, some are seen
    angle = torch.tensor(2.1, dtype=torch.float64)
    turn = torch.stack([angle.cos(), angle.sin(), -angle.sin(), angle.cos()]).reshape(2, 2)
    shift = torch.tensor([30.0, -40.0], dtype=torch.float64)
    turned = visual_field_graph(places @ turn + shift, headings @ turn, body_length=1.0)
    assert torch.equal(turned, graph)
    mirror = torch.tensor([1.0, -1.0], dtype=torch.float64)
    assert torch.equal(
        visual_field_graph(places * mirror, headings * mirror, body_length=1.0), graph
    )
    assert torch.equal(visual_field_graph(places * 100, headings, body_length=100.0), graph)
    order = torch.randperm(15, generator=torch.Generator().manual_seed(1))
    relabelled = visual_field_graph(places[:, order], headings[:, order], body_length=1.0)
    assert torch.equal(relabelled, graph[:, order][:, :, order])


def test_single_precision_differs_only_where_a_ray_grazes():
    """Among 4200 pairs, one whose visibility hangs on 1e-6 of an angle is not to be expected."""
    places, headings = crowd()
    exact = visual_field_graph(places, headings, body_length=1.0)
    single = visual_field_graph(places.float(), headings.float(), body_length=1.0)
    assert (single != exact).sum() <= 1


def by_tensors(monkeypatch, places, headings, **anatomy):
    """Return the graph as devices other than the processor compute it."""
    with monkeypatch.context() as patch:
        patch.setattr(visual, "_by_loop", visual._by_tensors)
        return visual_field_graph(places, headings, **anatomy)


@pytest.mark.parametrize("eyes", [1, 2])
@pytest.mark.parametrize("length", [0.3, 1.0, 3.0])
@pytest.mark.parametrize(
    "anatomy",
    [
        {},
        {"blind_angle": 0.0, "eye_field": 360.0},
        {"blind_angle": 200.0, "eye_field": 90.0, "rays": 41},
        {"max_distance": 2.5, "rays": 1000},
    ],
)
def test_the_compiled_loop_equals_the_tensors(monkeypatch, eyes, length, anatomy):
    """Crowds of which some are absent, rest or stand in each other; 8820 pairs a case."""
    places, headings = crowd(frames=42)
    generator = torch.Generator().manual_seed(3)
    places[torch.rand(42, 15, generator=generator) < 0.1] = NAN
    headings[torch.rand(42, 15, generator=generator) < 0.1] = 0.0
    headings[torch.rand(42, 15, generator=generator) < 0.1] = NAN
    anatomy = {"body_length": length, "eyes": eyes, **anatomy}
    graph = visual_field_graph(places, headings, **anatomy)
    assert 0 < graph.double().mean() < 0.9
    assert torch.equal(graph, by_tensors(monkeypatch, places, headings, **anatomy))


@pytest.mark.parametrize("name", ["zebrafish_idtracker8", "guppies_trex8", "termites8_idtracker"])
def test_the_compiled_loop_equals_the_tensors_on_real_animals(monkeypatch, shared_data, name):
    tracks = io.read(shared_data / name / f"{name}.npz").position[:400]
    places = torch.tensor(tracks.transpose("time", "individual", "space").values).double()
    step = float(places.diff(dim=0).norm(dim=-1).nanmedian())
    headings = headings_from_velocity(places.diff(dim=0, prepend=places[:1]), rest_speed=0.1 * step)
    anatomy = {"body_length": 0.5 * float(graphs.nearest_distances(places).nanmedian())}
    graph = visual_field_graph(places, headings, **anatomy)
    assert 0 < graph.double().mean() < 0.95
    assert torch.equal(graph, by_tensors(monkeypatch, places, headings, **anatomy))


SEE = """
import sys, torch
from swarmssm.graphs import visual_field_graph
assert "numba" not in sys.modules
places = torch.tensor([[0.0, 0.0], [3.0, 0.0], [6.0, 0.0]])
graph = visual_field_graph(places, torch.tensor([1.0, 0.0]).expand(3, 2), body_length=1.0)
assert graph.nonzero().tolist() == [[0, 1], [1, 2]], graph
"""


@pytest.mark.slow
def test_several_processes_compile_the_loop_at_once(tmp_path):
    """With an empty cache, and then one from a cache whose files are damaged."""
    command = [sys.executable, "-P", "-W", "error", "-c", SEE]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    processes = [subprocess.Popen(command, env=environment) for _ in range(2)]
    assert [process.wait(300) for process in processes] == [0, 0]
    files = list(tmp_path.rglob("*.nb[ic]"))
    assert len(files) == 2
    for file in files:
        file.write_bytes(file.read_bytes()[:50])
    subprocess.run(command, env=environment, check=True, timeout=300)


@pytest.mark.slow
def test_the_loop_runs_where_no_folder_can_be_written_to(tmp_path):
    """The package lies where it may not be written to, and the user has no cache folder."""
    package = Path(swarmssm.__file__).parent
    shutil.copytree(package, tmp_path / "swarmssm", ignore=shutil.ignore_patterns("__pycache__"))
    # A file in the place of the folder stops root too, whom permissions do not.
    (tmp_path / "swarmssm" / "graphs" / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "XDG"))
    } | {"HOME": str(tmp_path / "home"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-P", "-W", "error", "-c", SEE]
    subprocess.run(command, env=environment, check=True, timeout=300)


def test_frames_do_not_depend_on_each_other_or_on_portions(monkeypatch):
    places, headings = crowd()
    graph = visual_field_graph(
        places.reshape(4, 5, 15, 2), headings.reshape(4, 5, 15, 2), body_length=1.0
    )
    assert graph.shape == (4, 5, 15, 15)
    monkeypatch.setattr(visual, "RAYS_AT_ONCE", 700)
    for given, p, h in zip(graph.reshape(20, 15, 15), places, headings, strict=True):
        assert torch.equal(visual_field_graph(p, h, body_length=1.0), given)
        assert torch.equal(by_tensors(monkeypatch, p, h, body_length=1.0), given)


def test_the_nearest_is_always_seen():
    """Nothing can hide the body whose outline is nearest to an eye that looks all around."""
    generator = torch.Generator().manual_seed(2)
    places = 20 * torch.rand(200, 8, 2, dtype=torch.float64, generator=generator)
    headings = torch.tensor(EAST, dtype=torch.float64).expand_as(places)
    graph = visual_field_graph(
        places, headings, body_length=1.0, body_width=1.0, eyes=1, blind_angle=0.0
    )
    eye = places + torch.tensor([0.35, 0.0], dtype=torch.float64)
    distances = torch.cdist(eye, places)
    distances.diagonal(dim1=1, dim2=2).fill_(math.inf)
    nearest = distances.argmin(-1, keepdim=True)
    assert graph.gather(-1, nearest).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"body_length": 0.0}, "body_length: it must be a positive number, not 0.0"),
        ({"body_length": NAN}, "body_length"),
        ({"body_width": -1.0}, "body_width"),
        ({"max_distance": 0.0}, "max_distance"),
        ({"blind_angle": 360.0}, "blind_angle: it must be from 0 to below 360 degrees"),
        ({"blind_angle": -1.0}, "blind_angle"),
        ({"eye_field": 0.0}, "eye_field"),
        ({"eyes": 3}, "eyes: there can be 1 or 2, not 3"),
        ({"rays": 1}, "rays: each eye needs a whole number of rays"),
    ],
)
def test_wrong_anatomy_is_named(change, message):
    with pytest.raises(InputError, match=message):
        see([[0, 0], [3, 0]], [EAST, EAST], **change)


def test_wrong_shapes_are_named():
    with pytest.raises(InputError, match="two dimensions only"):
        visual_field_graph(torch.zeros(2, 3), torch.zeros(2, 3), body_length=1.0)
    with pytest.raises(InputError, match=r"headings: their shape \(3, 2\) differs"):
        visual_field_graph(torch.zeros(2, 2), torch.zeros(3, 2), body_length=1.0)


def test_headings_are_held_at_rest():
    """Unknown, rest, motion, slow motion, unknown, motion: held forward, never backward."""
    velocities = torch.tensor([[NAN, NAN], [0, 0], [3, 4], [0, 0.1], [NAN, NAN], [0, -2]])[:, None]
    headings = headings_from_velocity(velocities, rest_speed=0.1)[:, 0]
    expected = torch.tensor([[NAN, NAN]] * 2 + [[0.6, 0.8]] * 3 + [[0, -1]])
    torch.testing.assert_close(headings, expected, equal_nan=True)
    turned = headings_from_velocity(velocities)[:, 0]
    torch.testing.assert_close(turned[3:], torch.tensor([[0.0, 1], [0, 1], [0, -1]]))


def test_who_never_moves_gets_the_fallback():
    velocities = torch.zeros(2, 4, 3, 2)
    velocities[0, 1, 2] = torch.tensor([0.0, 5.0])
    assert headings_from_velocity(velocities)[1].isnan().all()
    headings = headings_from_velocity(velocities, fallback=(-3.0, 0.0))
    expected = torch.tensor([-1.0, 0.0]).expand(2, 4, 3, 2).clone()
    expected[0, 1:, 2] = torch.tensor([0.0, 1.0])
    torch.testing.assert_close(headings, expected)
    with pytest.raises(InputError, match="fallback: it must be a direction with 2 coordinates"):
        headings_from_velocity(velocities, fallback=(0.0, 0.0))
    with pytest.raises(InputError, match="rest_speed"):
        headings_from_velocity(velocities, rest_speed=-1.0)
    with pytest.raises(InputError, match="velocities: the shape"):
        headings_from_velocity(torch.zeros(3, 2))
