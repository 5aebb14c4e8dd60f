"""``fungrasp setup``: fetch once what is needed but not part of the package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fungrasp.cli.console import Answer, Answering


@dataclass(frozen=True)
class SetUpPerception(Answering):
    """Fetch the two hand models that ``perceive`` needs (8 MB, Apache-2.0) from the mediapipe wheel on the
    package index (36 MB), check them and keep them in the cache. Nothing is installed; later runs need no
    network."""

    wheel: Path | None = None
    """A wheel of mediapipe 0.10.21 at hand, for machines without network; by default pip downloads it."""

    def run(self) -> Answer:
        from fungrasp.perception.hand.mediapipe_models import fetch_weights, kept_weights

        paths = list((kept_weights() if self.wheel is None else []) or fetch_weights(self.wheel))
        return Answer({"models": paths}, "\n".join(map(str, paths)))


COMMAND = {"perception": SetUpPerception}
