"""Mean paths by one banded system, against the messages of the same chain."""

import pytest
import torch

from swarmssm.inference.guides.chains import Law, Observations, Start
from swarmssm.inference.guides.kinematic_chain import KinematicChain
from swarmssm.inference.guides.mean_paths import mean_paths

BATCH, TIMES, INDIVIDUALS = 2, 8, 5
CHAIN = KinematicChain(2, 0.1)


def parts(is_gappy: bool, times: int = TIMES) -> tuple[list[torch.Tensor], torch.Tensor]:
    """Return what a chain is told, and who is there."""
    generator = torch.Generator().manual_seed(0)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    frames = (BATCH, times, INDIVIDUALS)
    present = torch.ones(frames, dtype=torch.bool)
    if is_gappy:
        present[0, :3, 0] = False
        present[1, 2:5, 1] = False
        present[1, -2:, 2] = False
        present[0, :, 3] = False
    seen = (torch.rand(*frames, 1, generator=generator) > 0.3) & present.unsqueeze(-1)
    steps = (BATCH, times - 1, INDIVIDUALS)
    given = [
        draw(*frames, 4),
        draw(*frames, 4).exp() * seen,
        draw(*steps, 2),
        0.1 * draw(*steps, 2).exp(),
        0.1 * draw(*steps, 1),
        1.0 + 0.1 * draw(*steps, 1),
        draw(*frames, 4),
        draw(4).exp(),
    ]
    return [part.requires_grad_() for part in given], present


def mean(given: list[torch.Tensor], present: torch.Tensor, is_banded: bool) -> torch.Tensor:
    """Return the mean path."""
    law = Law(given[2], given[3], (given[4], given[5]))
    all_of_it = Observations(given[0], given[1]), law, Start(given[6], given[7]), present
    return CHAIN.mean(*all_of_it) if is_banded else CHAIN.steps(*all_of_it).mean(given[0])


@pytest.mark.parametrize("is_gappy", [False, True])
@pytest.mark.parametrize("times", [1, 2, TIMES])
def test_equals_messages_with_derivatives(is_gappy: bool, times: int) -> None:
    given, present = parts(is_gappy, times)
    banded, other = mean(given, present, True), mean(given, present, False)
    # Noises of 0.01 over steps of 0.1 make numbers of 1e4 beside 1: some twelve digits are left.
    torch.testing.assert_close(banded, other, rtol=1e-9, atol=1e-9)
    weight = torch.randn(banded.shape, generator=torch.Generator().manual_seed(1)).double()
    found = torch.autograd.grad((weight * banded).sum(), given, allow_unused=True)
    wanted = torch.autograd.grad((weight * other).sum(), given, allow_unused=True)
    for one, two in zip(found, wanted, strict=True):
        one, two = (torch.zeros(()) if part is None else part for part in (one, two))
        torch.testing.assert_close(*torch.broadcast_tensors(one, two), rtol=1e-8, atol=1e-8)


def test_second_derivatives() -> None:
    given, present = parts(True, 3)
    # The fast mode compares along random directions instead of entry by entry.
    assert torch.autograd.gradgradcheck(
        lambda *some: mean(list(some), present, True), given, fast_mode=True
    )


def test_single_precision_is_kept() -> None:
    given, present = parts(False)
    path = mean([part.detach().float() for part in given], present, True)
    assert path.dtype == torch.float32
    # Only input and output are rounded.
    torch.testing.assert_close(path.double(), mean(given, present, True), rtol=1e-4, atol=1e-4)


def test_what_has_no_mean_is_left_to_others() -> None:
    given, present = parts(False)
    broken = [part.detach().clone() for part in given]
    broken[3][0, 0, 0, 0] = torch.nan
    assert mean(broken, present, True).isnan().any()
    nothing = torch.zeros(1, 3, dtype=torch.float64)
    law = (nothing[:, 1:], nothing[:, 1:] + 1.0, nothing[:, 1:], nothing[:, 1:] + 1.0)
    enters = torch.tensor([[True, False, False]])
    persists = torch.ones(1, 2, dtype=torch.bool)
    assert mean_paths(0.1, (nothing, nothing), (nothing, nothing), law, persists, enters) is None
