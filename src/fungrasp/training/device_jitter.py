"""Random numbers that a device draws by itself."""

from __future__ import annotations

import torch


class DeviceJitter:
    """Jitter of sensors whose worlds are torch tensors (``fungrasp.task.sensors.Jitter``), from torch's
    generator of the device, whose state is part of checkpoints."""

    def __init__(self, on: torch.Tensor, seed: int):
        """
        Args:
            on: a tensor of the device and the number type.
            seed: of torch's generators.
        """
        torch.manual_seed(seed)
        self._kind = {"dtype": on.dtype, "device": on.device}

    def normal(self, *, size: tuple[int, int]) -> torch.Tensor:
        """Standard normal numbers."""
        return torch.randn(size, **self._kind)

    def random(self, count: int, /) -> torch.Tensor:
        """Numbers from 0 to 1."""
        return torch.rand(count, **self._kind)
