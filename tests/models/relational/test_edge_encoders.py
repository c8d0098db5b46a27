"""Hold the encoders to what they may depend on: order of names, who is absent, and the future."""

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.models.relational import DynamicEdgeEncoder, EdgeEncoder, pair_embedding
from swarmssm.models.relational.motion_features import individual_features, relative_features

CLOSE = {"rtol": 0, "atol": 2e-5}
BATCH, TIME, SIZE = 3, 6, 5
CHANGE = torch.tensor([0.5, 1.0, 1.5, 2.0])
relative = pytest.mark.parametrize("relative", [False, True])


def motion(seed=0, time=TIME, size=SIZE):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(BATCH, time, size, 4, generator=generator)


def static(relative=False, window=TIME):
    torch.manual_seed(0)
    return EdgeEncoder(4, window, 3, 16, change=CHANGE if relative else None, relative=relative)


def dynamic(relative=False):
    torch.manual_seed(0)
    change = CHANGE if relative else None
    return DynamicEdgeEncoder(4, 3, 16, recurrent=8, head=8, change=change, relative=relative)


def logits_of(kind, encoder, *args):
    """Return the one or both logits, ``(batch, any, individual, neighbor, type)``."""
    with torch.no_grad():
        out = encoder(*args)
    return out.unsqueeze(1) if kind is static else torch.cat(out, dim=1)


def off(size=SIZE):
    return ~torch.eye(size, dtype=torch.bool)


@relative
@pytest.mark.parametrize("kind", [static, dynamic])
def test_other_names_give_the_same_edges(kind, relative):
    encoder, states = kind(relative), motion()
    order = torch.tensor([3, 0, 4, 1, 2])
    logits = logits_of(kind, encoder, states)
    renamed = logits_of(kind, encoder, states[:, :, order])
    torch.testing.assert_close(renamed, logits[:, :, order][:, :, :, order], **CLOSE)
    # Directed, of each batch for itself, and nothing on the diagonal.
    assert (logits - logits.transpose(2, 3)).abs()[:, :, off()].amax() > 1e-3
    assert (logits[0] - logits[1]).abs().amax() > 1e-3
    assert (logits[:, :, ~off()] == 0).all()
    alone = logits_of(kind, encoder, states[1:2])
    torch.testing.assert_close(alone, logits[1:2], **CLOSE)


@relative
@pytest.mark.parametrize("kind", [static, dynamic])
def test_who_is_absent_changes_nothing(kind, relative):
    """One more who is never there, whatever stands in its place; and hidden frames."""
    encoder, states = kind(relative), motion()
    present = torch.ones(BATCH, TIME, SIZE, dtype=torch.bool)
    present[:, 2:4, 1] = False
    logits = logits_of(kind, encoder, states, present)
    garbage = torch.where(present.unsqueeze(-1), states, torch.nan)
    torch.testing.assert_close(logits_of(kind, encoder, garbage, present), logits, rtol=0, atol=0)
    more = torch.cat([states, torch.full((BATCH, TIME, 1, 4), torch.inf)], dim=2)
    there = torch.cat([present, torch.zeros(BATCH, TIME, 1, dtype=torch.bool)], dim=2)
    larger = logits_of(kind, encoder, more, there)
    torch.testing.assert_close(larger[:, :, :SIZE, :SIZE], logits, **CLOSE)
    assert (larger[:, :, SIZE] == 0).all()
    assert (larger[:, :, :, SIZE] == 0).all()
    # To be hidden is not the same as to stand in the middle.
    zero = torch.where(present.unsqueeze(-1), states, 0.0)
    assert (logits_of(kind, encoder, zero) - logits).abs().amax() > 1e-3


@relative
def test_the_prior_does_not_know_the_future_and_the_posterior_does(relative):
    encoder, states = dynamic(relative), motion()
    changed = states.clone()
    changed[:, 4:] += 1.0
    with torch.no_grad():
        (prior, posterior), (prior_2, posterior_2) = encoder(states), encoder(changed)
    torch.testing.assert_close(prior[:, :4], prior_2[:, :4], rtol=0, atol=1e-6)
    assert (prior[:, 4:] - prior_2[:, 4:]).abs()[:, :, off()].amax(-1).min() > 0
    assert (posterior - posterior_2).abs()[:, :, off()].amax(-1).min() > 0
    # And what came before counts: a memory, not only the frame itself.
    changed = states.clone()
    changed[:, 0] += 1.0
    with torch.no_grad():
        assert (encoder(changed)[0] - prior)[:, -1].abs().amax() > 0


@relative
def test_frame_by_frame_is_all_at_once(relative):
    encoder, states = dynamic(relative), motion()
    present = torch.ones(BATCH, TIME, SIZE, dtype=torch.bool)
    present[:, 3, 2] = False
    with torch.no_grad():
        prior, _, memory = encoder.encode(states, present)
        late, parts = None, []
        for t in range(TIME):
            found, late = encoder.filter(states[:, t : t + 1], present[:, t : t + 1], late)
            parts.append(found)
    torch.testing.assert_close(torch.cat(parts, dim=1), prior, **CLOSE)
    for one, other in zip(memory, late, strict=True):
        torch.testing.assert_close(one, other, **CLOSE)


def test_windows_shorter_and_longer():
    """A short one has nobody before it; a long one is the mean of windows, the last at its end."""
    encoder = static()
    long = motion(time=2 * TIME + 2)
    with torch.no_grad():
        parts = [encoder(long[:, start : start + TIME]) for start in (0, 2, 8)]
        torch.testing.assert_close(encoder(long), sum(parts) / 3, **CLOSE)
        short = encoder(long[:, :2])
        padded = torch.cat([torch.full((BATCH, TIME - 2, SIZE, 4), 9.0), long[:, :2]], dim=1)
        there = torch.arange(TIME).expand(BATCH, SIZE, TIME).transpose(1, 2) >= TIME - 2
        torch.testing.assert_close(short, encoder(padded, there), **CLOSE)
        # Windows in which one of the pair is not there do not count for it.
        present = torch.ones(BATCH, 2 * TIME + 2, SIZE, dtype=torch.bool)
        present[:, :8, 4] = False
        expected = encoder(long[:, 8:])[:, 4]
        torch.testing.assert_close(encoder(long, present)[:, 4], expected, **CLOSE)


@pytest.mark.parametrize("kind", [static, dynamic])
def test_graphs_one_after_the_other_are_the_same(kind, monkeypatch):
    """Values and gradients, when there is memory only for two graphs at once."""
    results = []
    for limit in (1 << 25, 2 * SIZE**2 * 16):
        monkeypatch.setattr(pair_embedding, "MOST_AT_ONCE", limit)
        encoder = kind(relative=True)
        out = encoder(motion())
        total = out.square().sum() if kind is static else sum(o.square().sum() for o in out)
        total.backward()
        results.append([total.detach(), *(p.grad for p in encoder.parameters())])
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


def test_relative_features_do_not_depend_on_where_the_origin_is():
    """All of a pair comes in by its differences; distance and relative speed are right."""
    states = motion()
    shifted = states + torch.tensor([5.0, -3.0, 1.0, 2.0])
    present = torch.ones(BATCH, TIME, SIZE, dtype=torch.bool)
    present[0, 0, 1] = False
    found = relative_features(states, present)
    torch.testing.assert_close(found, relative_features(shifted, present), rtol=0, atol=1e-4)
    apart = states[1, 2, 3] - states[1, 2, 0]
    expected = [*apart, apart[:2].norm(), apart[2:].norm()]
    torch.testing.assert_close(found[1, 2, 0, 3], torch.stack(expected), rtol=1e-5, atol=1e-5)
    assert (found[0, 0, 1] == 0).all()
    assert (found[0, 0, :, 1] == 0).all()


def test_changes_are_those_since_the_frame_before():
    """Of who was there in both, in the unit given; and they go on from a frame kept in memory."""
    states = motion()
    present = torch.ones(BATCH, TIME, SIZE, dtype=torch.bool)
    present[0, 2, 1] = False
    shown = torch.where(present.unsqueeze(-1), states, 0.0)
    found = individual_features(shown, present, CHANGE)
    assert (found[..., :4] == shown).all()
    assert (found[..., -1] == present).all()
    moved = found[..., 4:8]
    expected = (states[:, 1:] - states[:, :-1]) / CHANGE
    expected[0, 1:3, 1] = 0.0
    torch.testing.assert_close(moved[:, 1:], expected)
    assert (moved[:, 0] == 0).all()
    before = torch.cat([shown[:, 3], present[:, 3].unsqueeze(-1).float()], dim=-1)
    late = individual_features(shown[:, 4:], present[:, 4:], CHANGE, before)
    torch.testing.assert_close(late, found[:, 4:])
    assert individual_features(shown, present, None).shape[-1] == 5


def test_one_individual_alone_has_no_pairs():
    for kind in (static, dynamic):
        logits = logits_of(kind, kind(relative=True), motion(size=1))
        assert (logits == 0).all()


def test_mistakes_are_named():
    with pytest.raises(InputError, match="edge_types: it must be at least 2, and it is 1"):
        EdgeEncoder(4, 10, 1)
    with pytest.raises(InputError, match="window: it must be at least 1"):
        EdgeEncoder(4, 0)
    with pytest.raises(InputError, match="edge_types"):
        DynamicEdgeEncoder(4, 1)
