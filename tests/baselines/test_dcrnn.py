"""The random walks of DCRNN, worked out by hand."""

import torch

from swarmssm.baselines.dcrnn import random_walks


def test_walks_by_hand():
    # 0 sees 1 and 2, 1 sees 2, 2 sees nobody.
    graph = torch.tensor([[0.0, 1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    one, two, back, twice = random_walks(graph, 2)
    assert one.tolist() == [[0.0, 0.5, 0.5], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    assert two.tolist() == [[0.0, 0.0, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert back.tolist() == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.5, 0.0]]
    assert twice.tolist() == [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]


def test_walks_where_everybody_is_seen_keep_their_probability():
    graph = (torch.rand(5, 6, 6, generator=torch.Generator().manual_seed(0)) < 0.6).float()
    graph[..., 0, :] = graph[..., :, 0] = 1.0
    torch.testing.assert_close(random_walks(graph, 3).sum(-1), torch.ones(5, 6, 6))
