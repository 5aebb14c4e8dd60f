"""Several processes that learn together, one for each GPU, as ``torchrun`` starts them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch

from fungrasp.core.errors import FungraspError
from fungrasp.simulation import Device


class Processes(NamedTuple):
    """How many there are, and which of them this is."""

    count: int = 1
    """All of them."""
    number: int = 0
    """This one's, from 0."""

    @property
    def first(self) -> bool:
        """Whether this is the one that writes files and prints."""
        return self.number == 0

    def wait(self) -> None:
        """For all others to come here."""
        if self.count > 1:
            torch.distributed.barrier()

    def mean(self, value: float, device: str) -> float:
        """Over all of them."""
        if self.count == 1:
            return value
        total = torch.tensor(value, device=device)
        torch.distributed.all_reduce(total)
        return float(total) / self.count


@contextmanager
def joined(device: Device) -> Iterator[Processes]:
    """Connect the processes that were started together, each with a GPU of its own.

    Args:
        device: where the worlds of each are simulated.

    Raises:
        FungraspError: they find no connection.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Processes()
        return
    if device == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    try:
        torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    except (RuntimeError, ValueError) as error:
        words = " ".join(str(error).split())
        raise FungraspError(f"the processes of torchrun find no connection: {words}") from error
    try:
        yield Processes(torch.distributed.get_world_size(), torch.distributed.get_rank())
    finally:
        torch.distributed.destroy_process_group()
