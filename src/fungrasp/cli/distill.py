"""``fungrasp distill``: a student learns from a teacher what a robot can know."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from fungrasp.cli.console import Answer, Answering
from fungrasp.cli.training_options import check_numbers, check_packages, progress_lines
from fungrasp.training.settings import DistillSettings


@dataclass(frozen=True)
class Distill(Answering):
    """Train a student from a teacher: it sees what a robot has, and infers the contacts from how the joints
    move.

    Given again with the same settings, the command goes on where it was interrupted.
    """

    option_prefixes: ClassVar[bool] = True

    teacher: Path
    """Folder of a teacher's training (fungrasp train)."""
    out: Path
    """Folder of the student's training; student.onnx will be in it."""
    steps: float = 5e5
    """Control steps of all worlds together."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; where they were when the teacher was trained by default."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int = 0
    """Threads of the simulation; 0 means all processors."""
    settings: DistillSettings = field(default_factory=DistillSettings)
    """Settings of the learning."""

    def run(self) -> Answer:
        check_packages()
        import torch

        from fungrasp.training.student_run import STUDENT, train_student

        check_numbers(self.steps, self.seed, self.threads)
        # More threads make the small networks slower.
        torch.set_num_threads(1)
        card = train_student(
            self.teacher,
            self.out,
            int(self.steps),
            self.settings,
            self.seed,
            objects=self.objects,
            threads=self.threads,
            progress=progress_lines(int(self.steps)),
        )
        return Answer(
            {"policy": self.out / STUDENT, "card": card.to_json()},
            f"{self.out / STUDENT}: {card.kind} of {card.hand}, {card.budget.steps:,} steps in "
            f"{card.budget.seconds / 60:.1f} min, its teacher's included",
        )


COMMAND = Distill
