"""Hold graph rules to their text and JSON, and graphs in tracks to the functions that make them."""

import json

import numpy as np
import pytest
import torch

from swarmssm import graphs
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.tracks import make_tracks

TEXTS = {
    "radius:2.5": GraphRule("radius", radius=2.5),
    "radius:radius=2.5,box=10": GraphRule("radius", radius=2.5, box=10.0),
    "k-nearest:6": GraphRule("k-nearest", k=6),
    " k-nearest : k = 6 ": GraphRule("k-nearest", k=6),
    "visual": GraphRule("visual"),
    "visual:1.2": GraphRule("visual", body_length=1.2),
    "visual:body_length=1.2,blind_angle=60": GraphRule("visual", body_length=1.2, blind_angle=60.0),
    "visual:eyes=1,rays=64,max_distance=9": GraphRule("visual", eyes=1, rays=64, max_distance=9.0),
    "complete": GraphRule("complete"),
}


@pytest.mark.parametrize("text", TEXTS)
def test_a_rule_is_the_same_as_text_and_as_json(text):
    rule = TEXTS[text]
    assert GraphRule.parse(text) == rule
    assert GraphRule.parse(str(rule)) == rule
    assert GraphRule.from_dict(json.loads(json.dumps(rule.to_dict()))) == rule


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "kind '' is unknown; choose one of radius, k-nearest, visual, complete"),
        ("metric:2", "kind 'metric' is unknown"),
        ("radius", "a radius graph needs radius"),
        ("radius:wide", "radius must be a number, not 'wide'"),
        ("radius:-1", "radius: it must be a number from 0"),
        ("radius:nan", "radius must be a number"),
        ("radius:2,3", "'3' in 'radius:2,3' is not of the form name=value"),
        ("radius:2,k=3", "a radius graph has no parameter k; it has radius, box"),
        ("radius:radius=1,radius=2", "radius stands twice"),
        ("radius:6,box=10", "at most 5"),
        ("k-nearest", "a k-nearest graph needs k"),
        ("k-nearest:2.5", "k must be a whole number, not '2.5'"),
        ("k-nearest:0", "k: the number of neighbours"),
        ("visual:blind_angle=400", "blind_angle: it must be from 0 to below 360"),
        ("visual:1,eyes=3", "eyes: there can be 1 or 2"),
        ("visual:shape=round", "the field 'shape' is unknown"),
        ("complete:3", "'3' in 'complete:3' is not of the form"),
        ("complete:k=3", "a complete graph has no parameter k; it has none"),
    ],
)
def test_a_text_that_is_no_rule_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        GraphRule.parse(text)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"radius": 2.0}, "the field kind is absent"),
        ({"kind": "radius", "radius": True}, "radius must be a number, not True"),
        ({"kind": "radius", "radius": [1]}, "radius must be a number"),
        ({"kind": "radius", "radius": 1.0, "colour": 3}, "the field 'colour' is unknown"),
        ([1, 2], "a rule is a table of fields"),
    ],
)
def test_a_table_that_is_no_rule_is_refused(values, message):
    with pytest.raises(InputError, match=message):
        GraphRule.from_dict(values)


def test_a_rule_makes_the_graph_of_its_function():
    generator = torch.Generator().manual_seed(0)
    places, velocities = torch.rand(2, 4, 9, 2, generator=generator) * 5
    calls = {
        "radius:2": graphs.radius_graph(places, 2.0),
        "radius:2,box=5": graphs.radius_graph(places, 2.0, box=5.0),
        "k-nearest:2": graphs.k_nearest_graph(places, 2),
        "complete": graphs.complete_graph(places),
        "visual:0.5,eyes=1,rays=99,blind_angle=100": graphs.visual_field_graph(
            places, velocities, body_length=0.5, eyes=1, rays=99, blind_angle=100.0
        ),
        "visual:0.5,body_width=0.4,eye_field=90,max_distance=3": graphs.visual_field_graph(
            places, velocities, body_length=0.5, body_width=0.4, eye_field=90.0, max_distance=3.0
        ),
    }
    made = [GraphRule.parse(text)(places, velocities) for text in calls]
    for ours, expected in zip(made, calls.values(), strict=True):
        assert torch.equal(ours, expected)
    assert len({tuple(graph.flatten().tolist()) for graph in made}) == len(made)


def test_a_visual_rule_needs_a_body_and_velocities():
    places = torch.zeros(2, 2)
    with pytest.raises(InputError, match="body_length of the visual graph is not known"):
        GraphRule("visual")(places, places)
    with pytest.raises(InputError, match="velocities: a visual graph needs them"):
        GraphRule("visual", body_length=1.0)(places)


def line(**changes):
    """Return tracks of three at 0, 1 and 5 on the x axis, swimming in file along it at 1 / s.

    Nearest neighbours are 1, 1 and 4 away: the median is 1.
    """
    position = np.zeros((4, 3, 2))
    position[..., 0] = np.array([0.0, 1.0, 5.0]) + np.arange(4)[:, None]
    return make_tracks(position, fps=1.0, **changes)


def test_body_length_is_given_or_half_the_median_nearest_distance():
    assert graphs.body_length_of(line()) == 0.5
    assert graphs.body_length_of(line(attrs={"body_length": 0.7})) == 0.7
    rule = GraphRule("visual", blind_angle=10.0)
    assert rule.fitted_to(line()) == GraphRule("visual", blind_angle=10.0, body_length=0.5)
    fixed = GraphRule("visual", body_length=3.0)
    assert fixed.fitted_to(line()) == fixed
    assert GraphRule("complete").fitted_to(line()) == GraphRule("complete")
    with pytest.raises(InputError, match="body_length must be a number"):
        graphs.body_length_of(line(attrs={"body_length": "long"}))


def test_body_length_cannot_come_from_one_individual():
    alone = make_tracks(np.zeros((4, 1, 2)), fps=1.0)
    with pytest.raises(InputError, match="no body length can be estimated"):
        graphs.body_length_of(alone)
    together = make_tracks(np.zeros((4, 3, 2)), fps=1.0)
    with pytest.raises(InputError, match="no body length can be estimated"):
        graphs.body_length_of(together)


def test_default_rule():
    generator = np.random.default_rng(0)
    assert graphs.default_rule(line()) == GraphRule("visual", body_length=0.5)
    nearest = GraphRule("k-nearest", k=6)
    for shape, kind in (
        ((2, 100, 2), "visual"),
        ((2, 101, 2), "k-nearest"),
        ((2, 5, 3), "k-nearest"),
        ((2, 1, 2), "k-nearest"),
    ):
        rule = graphs.default_rule(make_tracks(generator.normal(size=shape), fps=1.0))
        assert rule.kind == kind
        assert kind == "visual" or rule == nearest


def test_add_adjacency_keeps_the_rule():
    rule = GraphRule("radius", radius=1.0)
    tracks = graphs.add_adjacency(line(), rule)
    adjacency = tracks["adjacency"]
    assert adjacency.dims == ("time", "individual", "neighbor")
    assert adjacency.dtype == np.uint8
    assert adjacency.sel(individual="0", neighbor="1").values.tolist() == [1] * 4
    assert int(adjacency.sum()) == 8
    assert graphs.rule_of(tracks) == rule
    assert "adjacency" not in line()


def test_add_adjacency_of_trials():
    position = np.random.default_rng(1).normal(size=(3, 5, 4, 2))
    position[1, 2, 3] = np.nan
    tracks = graphs.add_adjacency(make_tracks(position, fps=1.0), GraphRule("k-nearest", k=2))
    assert tracks["adjacency"].dims == ("trial", "time", "individual", "neighbor")
    expected = graphs.k_nearest_graph(torch.from_numpy(position), 2)
    np.testing.assert_array_equal(tracks["adjacency"].values, expected.numpy())


def test_add_adjacency_fits_and_looks_along_the_velocity():
    """In file: each sees the next one only; before any velocity nobody sees."""
    tracks = graphs.add_adjacency(line(), GraphRule("visual"))
    assert graphs.rule_of(tracks) == GraphRule("visual", body_length=0.5)
    assert not tracks["adjacency"].values[0].any()
    for frame in tracks["adjacency"].values[1:]:
        assert {tuple(e) for e in np.argwhere(frame).tolist()} == {(0, 1), (1, 2)}


def test_add_adjacency_replaces_only_when_told():
    first = graphs.add_adjacency(line(), GraphRule("complete"))
    with pytest.raises(InputError, match="they have an adjacency already"):
        graphs.add_adjacency(first, GraphRule("radius", radius=1.0))
    second = graphs.add_adjacency(first, GraphRule("radius", radius=1.0), overwrite=True)
    assert int(first["adjacency"].sum()) == 24
    assert int(second["adjacency"].sum()) == 8
    assert graphs.rule_of(second).kind == "radius"


def test_rule_of_tracks_without_one():
    assert graphs.rule_of(line()) is None
    given = line(adjacency=np.zeros((4, 3, 3)))
    assert graphs.rule_of(given) is None
    given["adjacency"].attrs["rule"] = "radius 3"
    with pytest.raises(InputError, match="attribute rule of adjacency is not JSON"):
        graphs.rule_of(given)
    given["adjacency"].attrs["rule"] = '{"kind": "odd"}'
    with pytest.raises(InputError, match="kind 'odd' is unknown"):
        graphs.rule_of(given)


def test_a_visual_graph_has_two_dimensions():
    deep = make_tracks(np.random.default_rng(0).normal(size=(3, 4, 3)), fps=1.0)
    with pytest.raises(InputError, match="two dimensions only"):
        graphs.add_adjacency(deep, GraphRule("visual"))


def test_a_rule_on_real_fish(shared_data):
    """Eight zebrafish with gaps: who is not tracked has no edge, and a fish sees some others."""
    recording = np.load(shared_data / "zebrafish_idtracker8" / "zebrafish_idtracker8.npz")
    length = float(recording["body_length_px"])
    tracks = make_tracks(
        recording["xy"], fps=float(recording["fps"]), attrs={"body_length": length}
    )
    rule = graphs.default_rule(tracks)
    assert rule == GraphRule("visual", body_length=length)
    adjacency = graphs.add_adjacency(tracks, rule)["adjacency"].values
    absent = np.isnan(recording["xy"]).any(-1)
    assert absent.any()
    assert not adjacency[absent].any()
    assert not adjacency.swapaxes(1, 2)[absent].any()
    # With a median of seven others all around, nobody sees none for long, and some are hidden.
    seen = adjacency.sum(-1)[~absent]
    assert (seen == 0).mean() < 0.05
    assert (seen < 7).mean() > 0.05
