"""Hold weights of pairs in simulated boids to a step worked by hand, and to planted leaders."""

import json

import numpy as np
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.simulate import dynamics_of, simulate_boids
from swarmssm.simulate.attention import planted_attention

THREE = {
    "initial_position": [[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]],
    "initial_velocity": [[1.0, 0.0], [0.0, 0.8], [1.0, 0.0]],
}


def forces(tracks, term):
    """Return a term in the first frame, (individual, space)."""
    chosen = tracks["force"].isel(trial=0, time=0).sel(term=term)
    return chosen.transpose("individual", "space").to_numpy()


def test_weights_by_hand():
    """The first counts the second three times and the third half, among two neighbors.

    C = (3 (2, 0) + 0.5 (0, 1)) / 2 times 0.5; S = -3 (2, 0) / 4 - 0.5 (0, 1) times 0.3;
    A = (3 (-1, 0.8) + 0.5 (0, 0)) / 2 times 0.2.
    """
    weights = np.ones((3, 3))
    weights[0] = [1.0, 3.0, 0.5]
    tracks = simulate_boids(3, 2, process_noise=0.0, attention=weights, **THREE)
    plain = simulate_boids(3, 2, process_noise=0.0, **THREE)
    expected = {
        "cohesion": [1.5, 0.125],
        "separation": [-0.45, -0.15],
        "alignment": [-0.3, 0.24],
    }
    for term, value in expected.items():
        np.testing.assert_allclose(forces(tracks, term)[0], value, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(forces(tracks, term)[1:], forces(plain, term)[1:])
    total = tracks["force"].isel(trial=0, time=0).sum("term")
    np.testing.assert_allclose(
        tracks["velocity"].isel(trial=0, time=1, individual=0),
        [1.0 + 0.1 * float(total[0, 0]), 0.1 * float(total[1, 0])],
        atol=1e-15,
    )
    np.testing.assert_array_equal(tracks["adjacency"], plain["adjacency"])


def test_weights_of_the_velocity_form_by_hand():
    """Mean velocity with weights: (3 (0, 0.8) + 0.5 (1, 0)) / 2 times 0.95."""
    weights = np.ones((3, 3))
    weights[0] = [1.0, 3.0, 0.5]
    tracks = simulate_boids(3, 2, form="velocity", process_noise=0.0, attention=weights, **THREE)
    np.testing.assert_allclose(
        forces(tracks, "alignment")[0], [0.95 * 0.25, 0.95 * 1.2], rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("form", ["acceleration", "velocity"])
def test_weights_of_one_change_nothing(form):
    plain = simulate_boids(5, 30, form=form, seed=3)
    ones = simulate_boids(5, 30, form=form, seed=3, attention=np.ones((5, 5)))
    np.testing.assert_allclose(ones["position"], plain["position"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ones["force"], plain["force"], rtol=0, atol=1e-12)


def test_the_isolated_one_feels_nothing_and_nobody_feels_it():
    """Moving the isolated one leaves the forces on all others as they are."""
    weights = planted_attention(4, isolated=2)
    places = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    found = []
    for place in ([0.3, 0.4], [0.9, 0.2]):
        places[2] = place
        tracks = simulate_boids(4, 2, attention=weights, initial_position=places,
                                initial_velocity=np.ones((4, 2)) * 0.6)  # fmt: skip
        social = tracks["force"].sel(term=["cohesion", "separation", "alignment"])
        found.append(social.isel(trial=0, time=0).to_numpy())
        assert (found[-1][..., 2] == 0.0).all()
        assert int(tracks["adjacency"].isel(trial=0, time=0).sum()) == 12
    np.testing.assert_array_equal(found[0][..., [0, 1, 3]], found[1][..., [0, 1, 3]])
    assert (found[0][..., [0, 1, 3]] != 0.0).any()


def test_planted_weights_by_hand():
    np.testing.assert_array_equal(
        planted_attention(4, leader=1, strength=3.0, heeds=0.5, isolated=3),
        [[1.0, 3.0, 1.0, 0.0], [0.5, 1.0, 0.5, 0.0], [1.0, 3.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
    )


def test_the_law_comes_back_from_the_tracks():
    """Also from recordings made before there were weights."""
    weights = planted_attention(4, leader=1)
    tracks = simulate_boids(4, 20, attention=weights, seed=5)
    dynamics = dynamics_of(tracks)
    np.testing.assert_array_equal(dynamics.attention, weights)
    position, velocity = (
        torch.from_numpy(
            tracks[name].transpose("trial", "time", "individual", "space").to_numpy().copy()
        )
        for name in ("position", "velocity")
    )
    force, _ = dynamics.forces(position, velocity)
    dims = ("trial", "time", "term", "individual", "space")
    np.testing.assert_array_equal(force, tracks["force"].transpose(*dims))
    told = json.loads(tracks.attrs["simulation"])
    del told["attention"]
    tracks.attrs["simulation"] = json.dumps(told)
    assert dynamics_of(tracks).attention is None


@pytest.mark.parametrize(
    ("attention", "word"),
    [
        (np.ones((3, 3)), "3 of them|4 of them"),
        (np.ones(4), "shape"),
        (-np.ones((4, 4)), "from 0 upwards"),
        (np.full((4, 4), np.nan), "finite"),
        ([[1.0, 2.0], [1.0]], "table"),
        ("leader", "table"),
    ],
)
def test_weights_that_are_none(attention, word):
    with pytest.raises(InputError, match=word):
        simulate_boids(4, 3, attention=attention)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"leader": 4}, "leader"),
        ({"isolated": -1}, "isolated"),
        ({"leader": 1, "isolated": 1}, "isolated"),
        ({"strength": -1.0}, "strength"),
    ],
)
def test_places_that_are_none(options, word):
    with pytest.raises(InputError, match=word):
        planted_attention(4, **options)


def test_a_law_of_another_number_is_refused():
    dynamics = dynamics_of(simulate_boids(3, 3, attention=np.ones((3, 3))))
    with pytest.raises(InputError, match="3 individuals, and there are 4"):
        dynamics.forces(torch.zeros(4, 2), torch.ones(4, 2))
