"""The words follow the numbers: planted numbers flip, and so do the words."""

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.report import sentences, wording

WORSE, BETTER, EQUAL = (4.0, 2.0, 1.0), (0.5, 2.0, 1.0), (1.0, 2.0, 1.01)


def test_the_verdict_says_where_the_model_wins_and_loses(planted):
    everywhere = {
        "mse": BETTER,
        "squared_error": BETTER,
        "amd_error": BETTER,
        "avd_error": BETTER,
        "accuracy": (0.9, 0.8, 0.8, 0.6),
    }
    verdict, reasons = sentences.verdict(planted(**everywhere))
    assert verdict.startswith("graph-vae beats the best of the simple rivals")
    assert "worse" not in verdict
    assert "on every count" in verdict
    assert len(reasons) == 5
    nowhere = dict.fromkeys(everywhere, WORSE) | {"accuracy": (0.5, 0.8, 0.8, 0.6)}
    verdict, _ = sentences.verdict(planted(**nowhere))
    assert verdict.startswith("graph-vae does worse than the best of the simple rivals")
    assert "beats" not in verdict
    assert "on every count" in verdict
    mixed = everywhere | {"mse": WORSE, "avd_error": EQUAL}
    verdict, _ = sentences.verdict(planted(**mixed))
    assert verdict == (
        "graph-vae beats the best of the simple rivals (stay put, constant velocity, an unchanged "
        "graph) 20 steps ahead, in predicting the next graph and in the cohesion of free runs; it "
        "is as good as the best of them in the alignment of free runs; it does worse than the best "
        "of them one step ahead."
    )


def test_nothing_known_is_said(planted):
    unknown = (np.nan,) * 3
    evaluation = planted(
        mse=unknown,
        squared_error=unknown,
        amd_mean=unknown,
        avd_mean=unknown,
        amd_error=unknown,
        avd_error=unknown,
        accuracy=(np.nan,) * 4,
    )
    assert sentences.verdict(evaluation) == ("Nothing could be compared for graph-vae.", [])


@pytest.mark.parametrize(
    ("mse", "text"),
    [
        (
            (0.13, 0.05, 0.02),
            "Constant velocity has the lower one-step error: MSE 0.0200 against 0.130 for "
            "graph-vae.",
        ),
        (
            (0.13, 0.02, 0.05),
            "Stay put has the lower one-step error: MSE 0.0200 against 0.130 for graph-vae.",
        ),
        (
            (0.01, 0.02, 0.05),
            "graph-vae has the lower one-step error: MSE 0.0100 against 0.0200 for stay put.",
        ),
        (
            (0.0202, 0.02, 0.05),
            "One step ahead, graph-vae and stay put do equally well (MSE 0.0202 and 0.0200).",
        ),
        (
            (np.inf, 0.02, 0.05),
            "Stay put has the lower one-step error: MSE 0.0200 against infinite for graph-vae.",
        ),
    ],
)
def test_one_step(planted, mse, text):
    assert sentences.one_step_sentence(planted(mse=mse)) == text


def test_the_noise_floor_is_named_where_it_is_known(planted):
    text = sentences.one_step_sentence(planted(mse=(0.5, 2.0, 1.0), floor=0.05))
    assert text.endswith("; the noise floor, 0.0500, is 10 times below graph-vae.")
    text = sentences.one_step_sentence(planted(mse=(0.051, 2.0, 1.0), floor=0.05))
    assert text.endswith("; graph-vae is at the noise floor, 0.0500.")


def test_steps_ahead(planted):
    def said(own):
        return sentences.horizon_sentence(planted(squared_error=(own, 2.0, 1.0)))

    rising, falling = np.linspace(0.1, 2.0, 20), np.linspace(2.0, 0.1, 20)
    assert said(0.5).startswith(
        "graph-vae errs less than the better of stay put and constant velocity at every number of "
        "steps up to 20; at 20 steps its squared error is 0.500 against 1.00."
    )
    assert "errs more than the better of" in said(3.0)
    # 0.1 k < 1 up to k = 9, and as much or more from 10 on.
    assert "only below 10 steps ahead" in said(rising + 1e-9)
    assert "only from 12 steps ahead on" in said(falling)
    assert "at 10 of 20 numbers of steps" in said(np.tile([0.5, 1.5], 10))
    assert "against" in said(np.inf)


def test_edges(planted):
    text = sentences.edge_sentence(planted(accuracy=(0.9, 0.95, 0.7, 0.6)))
    assert text == (
        "graph-vae is right on 90.0 % of the pairs of the next graph, where the same graph as "
        "before is right on 95.0 % and no edge at all on 60.0 % (AUC 0.900, where 0.5 knows "
        "nothing)."
    )


@pytest.mark.parametrize(
    ("own", "words"),
    [(0.5, "are tighter than"), (2.0, "are looser than"), (1.01, "are as tight as")],
)
def test_cohesion(planted, own, words):
    evaluation = planted(amd_mean=(own, 1.0, 1.0), amd_error=(0.5, 0.2, 0.3))
    text = sentences.collective_sentence(evaluation, "amd")
    assert f"Free runs of graph-vae {words} the true group" in text
    assert "against 1.00 cm" in text
    assert text.endswith("off by 0.500, more than stay put (0.200).")


@pytest.mark.parametrize(
    ("own", "words"),
    [(0.5, "move more alike than"), (2.0, "move less alike than"), (1.01, "move as alike as")],
)
def test_alignment(planted, own, words):
    evaluation = planted(avd_mean=(own, 1.0, 1.0), avd_error=(0.1, 0.2, 0.3))
    text = sentences.collective_sentence(evaluation, "avd")
    assert f"Free runs of graph-vae {words} the true group" in text
    assert "against 1.00 cm/s" in text
    assert text.endswith("off by 0.100, less than stay put (0.200).")


def test_runs_that_leave_all_bounds(planted):
    evaluation = planted(amd_mean=(np.inf, 1.0, 1.0))
    assert sentences.collective_sentence(evaluation, "amd") == (
        "Free runs of graph-vae leave all bounds."
    )


def test_imitation(planted):
    """Half a unit off, a step being one; the free run stands still, as nobody moving would."""
    assert sentences.imitation_sentence(planted()) == (
        "Predicted one step at a time, individuals are 0.500 cm from where they truly are, 0.50 "
        "times the length of a true step; running freely, 5.00 cm after 0.500 s, where it would be "
        "5.00 cm had nobody moved."
    )


def test_snapshots(planted):
    assert sentences.snapshots_sentence(planted()) == (
        "After 0.500 s the true group keeps 1.00 cm from neighbour to neighbour with a "
        "polarization of 1.00, the imitated one keeps 1.00 cm from neighbour to neighbour with a "
        "polarization of 1.00 (1: all head one way)."
    )


def test_graphs(planted):
    """Two rings of eight directed edges, one of them missed in each; twelve pairs a ring."""
    assert sentences.graphs_sentence(planted()) == (
        "In the 2 graphs shown there are 16 edges, and 14 are predicted, of which 14 are true; "
        "91.7 % of all pairs are right."
    )


def test_training(planted):
    text = sentences.training_sentence(planted().history)
    assert text.startswith("The loss fell from 4.00 to 1.00 nats per coordinate in 3 epochs")
    assert "longer training may help" in text
    assert text.endswith(
        "the weights are those of epoch 2, where the validation loss was least; the one-step MSE, "
        "which is not what the loss measures, was lower later: 1.00 in epoch 3 against 2.00."
    )
    rising = planted().history.copy(deep=True)
    rising["loss"][:] = [1.0, 2.0, 3.0]
    rising["validation_loss"][:] = [3.0, 2.0, 1.0]
    text = sentences.training_sentence(rising)
    assert text.startswith("The loss did not fall: 1.00 at first, 3.00 nats per coordinate after 3")
    assert text.endswith("the weights are those of the last epoch.")
    drifting = planted().history.copy(deep=True)
    drifting["mse"][:] = [0.1, 0.5, 2.0]
    assert "was lower before: 0.100 in epoch 1 against 0.500." in (
        sentences.training_sentence(drifting)
    )
    flat = xr.Dataset({"loss": ("epoch", [9.0, 1.0] + [1.0] * 20)}, {"epoch": np.arange(22) + 1})
    assert "hardly fell any more" in sentences.training_sentence(flat)
    assert sentences.training_sentence(xr.Dataset()) == "The course of training is not known."


def test_random_starts(planted):
    """A unit square shrinks to half its side."""
    assert sentences.random_starts_sentence(planted()) == (
        "From random places and headings, the distance to the nearest neighbour goes from 1.00 cm "
        "to 0.500 cm in 0.500 s (true group: 1.00 cm), the polarization from 1.00 to 1.00."
    )


def test_numbers_within_five_percent_are_alike():
    assert wording.better(1.0, 1.04) == 0
    assert wording.better(1.0, 1.06) == 1
    assert wording.better(1.06, 1.0) == -1
    assert wording.better(np.inf, 1.0) == -1
    assert wording.better(np.inf, np.inf) == 0
    assert wording.better(0.0, 0.0) == 0
    assert wording.better(np.nan, 1.0) is None
