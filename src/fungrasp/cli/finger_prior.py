"""``fungrasp finger-prior``: learns where fingers are that an object hides."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.train import check_packages
from fungrasp.training.finger_examples import FingerPriorSettings

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet


@dataclass(frozen=True)
class TrainFingerPrior:
    """Synthesize many human grasps, and learn from them how a finger is bent, given the object and the other
    fingers.

    Writes the weights and, beside them, their card (.json). The grasps are kept beside them as well, so that
    an interrupted command goes on where it was.
    """

    out: Path
    """File of weights to write (.npz)."""
    batches: tuple[int, ...] = (50, 40)
    """Numbers of batches of some 35 grasps, of seed 1, 2 and so on."""
    held_out: tuple[str, ...] = ("mug", "hammer", "spray_bottle", "tennis_ball", "teapot", "knife")
    """Built-in objects that are left out, to try the prior on."""
    checked: tuple[str, ...] = ("bottle", "drill", "clamp")
    """Built-in objects, besides every sixth shape, that are only for the validation curve."""
    seed: int = 0
    """Seed of the learning."""
    settings: FingerPriorSettings = field(default_factory=FingerPriorSettings)
    """Settings of the examples and of the learning."""

    def run(self) -> None:
        check_packages()
        from time import perf_counter

        import numpy as np
        import torch

        from fungrasp import __version__
        from fungrasp.cli.console import progress_bar, write_json
        from fungrasp.files import atomic_path
        from fungrasp.provenance import machine
        from fungrasp.synthesis.varied_grasps import varied_object
        from fungrasp.training.finger_examples import FingerExamples, finger_examples
        from fungrasp.training.finger_prior import fit_finger, save_weights

        start = perf_counter()
        torch.set_num_threads(1)
        sets = self._grasps()
        parts = []
        with progress_bar("making examples", len(sets)) as show:
            for number, grasps in enumerate(sets):
                models = {name: varied_object(name) for name in np.unique(grasps.object_name).tolist()}
                rng = np.random.default_rng([self.seed, number])
                parts.append(finger_examples(grasps, models, rng, self.settings))
                show(number + 1)
        examples = FingerExamples.join(parts)
        base = np.array([name.partition(" x")[0] for name in examples.object_name.tolist()])
        shapes = np.unique([name for name in base.tolist() if ":" in name])[::6]
        checked = np.isin(base, self.checked) | np.isin(base, shapes)
        networks, curves = [], []
        with progress_bar("learning", 5) as show:
            for finger in range(5):
                network, curve = fit_finger(
                    finger, examples.select(~checked), examples.select(checked), self.settings, self.seed
                )
                networks.append(network)
                curves.append(curve)
                show(finger + 1)
        with atomic_path(self.out) as part, part.open("wb") as stream:
            save_weights(stream, networks)
        card = {
            "what": "mixtures of Gaussians of a finger's angles, given an object's surface and other fingers",
            "trained on": f"{sum(len(grasps) for grasps in sets)} synthesized human grasps of "
            f"{len(np.unique(base))} objects in other sizes; {len(examples.angles)} examples",
            "not trained on": list(self.held_out),
            "validated on": [*self.checked, f"{len(shapes)} shapes"],
            "licence": "Apache-2.0",
            "settings": asdict(self.settings),
            "batches": list(self.batches),
            "seed": self.seed,
            "version": __version__,
            "seconds": round(perf_counter() - start),
            "machine": machine(),
            "negative log-likelihood by epoch, training and validation, of index to thumb": [
                [[round(value, 3) for value in pair] for pair in curve] for curve in curves
            ],
        }
        write_json(self.out.with_suffix(".json"), card)
        last = [curve[-1][1] for curve in curves]
        print(
            f"{self.out}: negative log-likelihood {np.mean(last):.2f} nats a finger, of objects it has "
            "not seen"
        )

    def _grasps(self) -> list[HumanGraspSet]:
        """Those that are kept, and new ones where there are none yet."""
        from fungrasp.cli.console import progress_bar
        from fungrasp.grasps import load_human_grasps, save_human_grasps
        from fungrasp.synthesis.varied_grasps import varied_grasps

        folder, sets = self.out.with_suffix(".grasps"), []
        with progress_bar("synthesizing", sum(self.batches)) as show:
            done = 0
            for seed, count in enumerate(self.batches, start=1):
                for number in range(count):
                    path = folder / f"{seed}_{number:04d}.npz"
                    if path.is_file():
                        sets.append(load_human_grasps(path))
                    else:
                        made = varied_grasps(seed, number, self.held_out)
                        if made is not None:
                            folder.mkdir(parents=True, exist_ok=True)
                            save_human_grasps(path, made)
                            sets.append(made)
                    done += 1
                    show(done)
        return sets


COMMAND = TrainFingerPrior
