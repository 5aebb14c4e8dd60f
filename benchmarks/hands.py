"""``python -m benchmarks.hands``: descriptions by other makers, added as they are, and their grasps."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks.command import check_positive, main
from fungrasp.cli.console import table
from fungrasp.core.errors import FungraspError


@dataclass(frozen=True)
class AddedHand:
    """What became of one description; None where it was refused."""

    hand: str
    """Its title."""
    side: str | None = None
    """"right" or "left"; left hands get mirrored grasps."""
    fingers: int | None = None
    """With the thumb."""
    driven: int | None = None
    """Independent joints."""
    joints: int | None = None
    """All joints."""
    warnings: int | None = None
    """Of adding and of the check."""
    notes: int | None = None
    """Likewise."""
    contact_error_mm: float | None = None
    """Mean over the grasps."""
    self_penetration_mm: float | None = None
    """Deepest of the grasps."""
    lifted: int | None = None
    """Grasps that lift and hold their object, by the reference motion."""
    grasps: int | None = None
    """Grasps that were tried."""
    refused: str | None = None
    """Why there is no hand, in a line."""


@dataclass(frozen=True)
class AddedHands:
    """Add hands from their makers' URDFs and MJCFs with `fungrasp hands add` and no option, and try built-in
    grasps with each: contact, self-penetration, success of the reference motion."""

    files: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="TITLE=FILE")]
    """Descriptions, each with a title for the table: "ORCA, right=scene_right.xml"."""
    every: int = 3
    """Every so many of the built-in grasps."""
    first: int = 0
    """The first of them."""
    threads: int = 0
    """0 means all processors; the result does not depend on it."""
    json: Path | None = None
    """Write the numbers here (.json, with a .csv beside)."""

    def run(self) -> None:
        from tempfile import TemporaryDirectory

        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation.result_files import write_result

        check_positive(every=self.every)
        entries = [entry.rpartition("=") for entry in self.files]
        if not entries or not all(title for title, _, _ in entries):
            raise FungraspError("give at least one description, as TITLE=FILE")
        rows = []
        for title, _, file in entries:
            with TemporaryDirectory() as folder:
                rows.append(added_hand(title, Path(file), Path(folder), self))
            print(_words(rows[-1]), flush=True)
            if self.json is not None:
                # Where the files lay does not matter to anyone else.
                command = (
                    f"python -m benchmarks.hands TITLE=FILE ... --every {self.every} --first {self.first}"
                )
                write_result(self.json, run_record(0) | {"command": command}, map(asdict, rows))
        print(
            table(
                [list(asdict(rows[0])), *([_text(value) for value in asdict(row).values()] for row in rows)]
            )
        )
        print(machine())


def added_hand(title: str, file: Path, folder: Path, options: AddedHands) -> AddedHand:
    """Add one description, its hand into the folder, and try it."""
    import numpy as np

    from fungrasp.evaluation import evaluate
    from fungrasp.evaluation.grasp_quality import static_quality
    from fungrasp.grasps import load_human_grasps, load_objects, mirrored_grasps
    from fungrasp.hands import load_hand
    from fungrasp.hands.adding.add_hand import add_hand
    from fungrasp.retargeting import retarget

    try:
        path, findings = add_hand(file, folder / "hand", "hand")
    except FungraspError as reason:
        return AddedHand(title, refused=str(reason).replace(f"{file.parent}/", ""))
    errors = [finding.message for finding in findings if finding.severity == "error"]
    if errors:
        return AddedHand(title, refused=errors[0])
    hand, human = load_hand(path), load_human_grasps("builtin")
    human = human.select(np.arange(options.first, len(human), options.every))
    if hand.side == "left":
        human = mirrored_grasps(human)
    objects = load_objects(human)
    robot = retarget(human, objects, hand, threads=options.threads)
    quality = static_quality(robot, human, objects, hand).summary()
    success = evaluate(robot, objects, hand=hand, threads=options.threads).outcomes.success
    return AddedHand(
        title,
        hand.side,
        len(hand.fingers),
        len(hand.actuators),
        len(hand.joint_names),
        sum(finding.severity == "warning" for finding in findings),
        sum(finding.severity == "note" for finding in findings),
        quality["contact_error_mm"]["mean"],
        quality["self_penetration_mm"]["max"],
        int(success.sum()),
        len(success),
    )


def _words(row: AddedHand) -> str:
    return f"{row.hand}: {row.refused or f'{row.lifted} of {row.grasps} objects are lifted'}"


def _text(value: object) -> str:
    return "–" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


COMMAND = AddedHands

if __name__ == "__main__":
    main("hands", COMMAND)
