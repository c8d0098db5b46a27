"""The two halves of DyGrEncoder against torch's own cells."""

import numpy as np
import torch

from swarmssm.baselines.dygrencoder import DyGrEncoder
from swarmssm.baselines.step_network import Setting
from swarmssm.tracks.scaling import Scaler


def network():
    torch.manual_seed(0)
    scaler = Scaler("none", (0.0,) * 4, (1.0,) * 4)
    return DyGrEncoder().build(Setting(4, torch.full((4,), 0.5), scaler, 10.0))


def test_one_step_by_hand():
    made = network()
    generator = torch.Generator().manual_seed(1)
    states = torch.randn(1, 3, 4, generator=generator)
    # 0 sees 1 and 2, 1 sees 2, 2 sees nobody.
    graph = torch.tensor([[[0.0, 1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]])
    mask = torch.ones(1, 3, dtype=torch.bool)
    following, memory = made.step(states, mask, graph, made.begin(states))
    hidden = torch.nn.functional.pad(states[0], (0, 60))
    for weight in made.gather.weight:
        sent = hidden @ weight
        messages = torch.stack([(sent[1] + sent[2]) / 2, sent[2], torch.zeros(64)])
        hidden = made.gather.unit(messages, hidden)
    write, keep, read, new = made.unit.given(hidden).chunk(4, dim=-1)
    cell = torch.sigmoid(write) * torch.tanh(new)
    out = torch.sigmoid(read) * torch.tanh(cell)
    torch.testing.assert_close(memory["cell"][0], cell)
    expected = states[0] + 0.5 * made.out(out.relu())
    torch.testing.assert_close(following[0], expected)
    np.testing.assert_array_equal(keep.shape, (3, 64))


def test_running_is_stepping():
    made = network()
    generator = torch.Generator().manual_seed(2)
    states = torch.randn(2, 6, 3, 4, generator=generator)
    graph = (torch.rand(2, 6, 3, 3, generator=generator) < 0.5).float()
    mask = torch.ones(2, 6, 3, dtype=torch.bool)
    expected, last = made.run(states, mask, graph)
    memory = made.begin(states[:, 0])
    for frame in range(6):
        part = states[:, frame], mask[:, frame], graph[:, frame]
        following, memory = made.step(*part, memory)
        torch.testing.assert_close(expected[:, frame], following)
    for name, part in last.items():
        torch.testing.assert_close(part, memory[name])


def test_who_is_gone_forgets():
    made = network()
    states = torch.randn(1, 4, 2, 4, generator=torch.Generator().manual_seed(3))
    graph = torch.zeros(1, 4, 2, 2)
    mask = torch.ones(1, 4, 2, dtype=torch.bool)
    mask[0, 1, 0] = False
    _, memory = made.run(states, mask, graph)
    _, fresh = made.run(states[:, 2:], mask[:, 2:], graph[:, 2:])
    _, whole = made.run(states, torch.ones_like(mask), graph)
    for name, part in memory.items():
        torch.testing.assert_close(part[0, 0], fresh[name][0, 0])
        torch.testing.assert_close(part[0, 1], whole[name][0, 1])
        assert not torch.allclose(part[0, 0], whole[name][0, 0])
