"""Makes the film on the documentation's first page: ``python -m benchmarks.documents.film``.

It is the demonstration's own film, with one grasp more, encoded smaller.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import av
import numpy as np
from PIL import Image

from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.grasps.picks import picked_rows
from fungrasp.hands import load_hand
from fungrasp.media.demonstration import FPS, Shown, demonstrate
from fungrasp.media.video import write_video
from fungrasp.policies import default_policy

IMAGES = Path(__file__).parents[2] / "docs" / "images"

SHOWN = (
    ("allegro", ("mug:hand over", "drill:drill")),
    ("shadow", ("spray_bottle:spray",)),
    ("leap", ("bottle:pour",)),
)
"""Hands and what they grasp."""

QUALITY = 30.0
"""Constant rate factor: a film in a repository is to be small."""


def frames_of(path: Path) -> list[np.ndarray]:
    """All frames of a film."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def main() -> None:
    """Write the film, and a picture that stands for it."""
    everything, frames = builtin_grasps(), []
    for name, picks in SHOWN:
        human = everything.select(picked_rows(everything, picks, len(picks), ()))
        with TemporaryDirectory() as folder:
            shown = Shown(human, load_objects(human), {})
            made = demonstrate(shown, load_hand(name), default_policy(name), Path(folder), threads=1)
            frames += frames_of(made.film)
    write_video(IMAGES / "demo.mp4", frames, FPS, quality=QUALITY)
    Image.fromarray(frames[len(frames) // 5]).save(IMAGES / "demo.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    main()
