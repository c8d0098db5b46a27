"""Checkpoints: one safetensors file, replaced whole, that continues a training run exactly."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch

from swarmssm.errors import InputError
from swarmssm.files import write_beside

__all__ = ["Checkpoint", "read_checkpoint", "read_tensors", "write_checkpoint", "write_tensors"]

FILE_NAME = "last.safetensors"


@dataclass(frozen=True)
class Checkpoint:
    """Where training stood after a whole number of epochs.

    Attributes
    ----------
    tensors
        By name: ``weights.*``, ``best.*``, ``optimizer.<index>.<field>`` and ``rng``.
    state
        JSON values: epoch, step, history, best loss, and a digest of data and settings.
    """

    tensors: dict[str, torch.Tensor]
    state: dict[str, Any]

    def group(self, prefix: str) -> dict[str, torch.Tensor]:
        """Return the tensors of one group, without its prefix."""
        start = f"{prefix}."
        return {k.removeprefix(start): v for k, v in self.tensors.items() if k.startswith(start)}


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Write beside and rename, so that a kill at any moment leaves a whole checkpoint.

    Raises
    ------
    WorkError
        If the disk is full; the checkpoint before this one is then still there.
    """
    metadata = {"state": json.dumps(checkpoint.state)}
    write_tensors(folder / FILE_NAME, checkpoint.tensors, metadata)


def read_checkpoint(folder: Path) -> Checkpoint | None:
    """Return the last checkpoint of a run folder's ``checkpoint`` folder, if there is one.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return None
    tensors, metadata = read_tensors(path)
    try:
        return Checkpoint(tensors, dict(json.loads(metadata["state"])))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: it is not a checkpoint of a fit. Delete it to start anew."
        ) from error


def write_tensors(
    path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str] | None = None
) -> None:
    """Write tensors as safetensors, replacing the file as a whole."""
    # Copies: weights that share their memory would be refused.
    plain = {
        name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in tensors.items()
    }
    data = safetensors.torch.save(plain, metadata)
    with write_beside(path, overwrite=True) as temporary:
        temporary.write_bytes(data)


def read_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Read a safetensors file: tensors and metadata. Nothing in it can run.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    try:
        with safetensors.safe_open(str(path), framework="pt") as opened:
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
            return tensors, dict(opened.metadata() or {})
    except FileNotFoundError:
        raise InputError(f"{path}: this file of the run is missing.") from None
    except (safetensors.SafetensorError, OSError, ValueError) as error:
        raise InputError(f"{path}: the file is damaged and cannot be read ({error}).") from error
