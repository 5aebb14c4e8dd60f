"""Writing human grasps, with words about what is unusual in them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet


def write_human_grasps(path: Path, grasps: HumanGraspSet) -> None:
    """Write a file, and print how many grasps it holds and what is unusual in them.

    Raises:
        FungraspError: it can't be written.
    """
    from fungrasp.grasps import save_human_grasps
    from fungrasp.grasps.anatomy import check_anatomy, grouped
    from fungrasp.grasps.diagnosis import table_remarks

    save_human_grasps(path, grasps)
    findings = check_anatomy(grasps)
    print(f"{path}: {len(grasps)} grasps of {len(set(grasps.object_name.tolist()))} objects")
    for remark in table_remarks(grasps.hand_joints):
        print(f"{remark}; 'fungrasp grasps convert --below-table lift' or 'drop' mends it")
    for finding in grouped(findings):
        print(f"unusual anatomy: {finding}")
