"""The episodes that a distillation learns from, one file for each round, so that it can go on with them."""

from __future__ import annotations

import logging
import shutil
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDict

from fungrasp.training.checkpoint import read_checkpoint, write_checkpoint
from fungrasp.training.history import HISTORY

_log = logging.getLogger(__name__)

GROUPS = ("robot", "privileged", "action")
"""What is kept as it is; of the history, which is ten times as large, what it can be made from again."""


@dataclass(frozen=True)
class Round:
    """S control steps of W worlds."""

    batch: TensorDict
    """What the student learns from, shape [S W]; the groups "robot", "privileged", "history", "action"."""
    begun: torch.Tensor
    """Whether a world's episode was new, shape [S, W] bool."""


class KeptRounds:
    """The last rounds, in memory and in a folder."""

    def __init__(self, most: int, folder: Path | None):
        """
        Args:
            most: rounds that are kept.
            folder: for their files; in memory only if None.
        """
        self.batches: deque[TensorDict] = deque(maxlen=most)
        """The rounds, the last one last."""
        self._folder = folder

    def add(self, number: int, one: Round) -> None:
        """One more round. number: counted from 0.

        Raises:
            FungraspError: its file can't be written.
        """
        self.batches.append(one.batch)
        if self._folder is not None:
            steps, worlds = one.begun.shape
            parts = {name: one.batch[name].unflatten(0, (steps, worlds)) for name in GROUPS}
            window = one.batch["history"].unflatten(0, (steps, worlds)).unflatten(2, (HISTORY, -1))
            parts |= {"begun": one.begun, "first": window[0].clone(), "seen": window[:, :, -1].clone()}
            write_checkpoint(self._path(number), parts)

    def load(self, rounds: int) -> None:
        """Read the last of so many rounds back.

        Raises:
            FungraspError: a file is damaged.
        """
        assert self._folder is not None
        for number in range(max(0, rounds - (self.batches.maxlen or 0)), rounds):
            if not self._path(number).is_file():
                _log.warning("%s is missing: going on without these episodes", self._path(number))
                continue
            state = read_checkpoint(self._path(number))
            windows = _windows(state["seen"], state["begun"], state["first"])
            groups = {name: state[name].flatten(0, 1) for name in GROUPS}
            groups["history"] = windows.flatten(0, 1)
            self.batches.append(TensorDict(groups, batch_size=[len(groups["robot"])]))

    def forget_before(self, number: int) -> None:
        """Delete files of earlier rounds."""
        if self._folder is not None:
            for path in self._folder.glob("*.pt"):
                if path.stem.isdigit() and int(path.stem) < number:
                    path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete all files."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, number: int) -> Path:
        assert self._folder is not None
        return self._folder / f"{number:06d}.pt"


def _windows(seen: torch.Tensor, begun: torch.Tensor, first: torch.Tensor) -> torch.Tensor:
    """The histories of a round, shape [S, W, HISTORY H], as ``History`` made them.

    Args:
        seen: what was added at each step, shape [S, W, H].
        begun: shape [S, W] bool.
        first: the histories at the first step, shape [W, HISTORY, H].
    """
    window = first
    windows = [window]
    for last, new in zip(seen[1:], begun[1:], strict=True):
        window = torch.where(new[:, None, None], 0.0, window)
        window = torch.cat([window[:, 1:], last[:, None]], dim=1)
        windows.append(window)
    return torch.stack(windows).flatten(2)
