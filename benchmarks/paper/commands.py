"""``python -m benchmarks.paper``: train and test what the paper compares, and train the free policies."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.paper.free_policies import FreePolicies
from benchmarks.paper.table_training import TableOptions
from fungrasp.core.errors import FungraspError


@dataclass(frozen=True)
class RetargetingTable(TableOptions):
    """Compare retargeting methods (Table IV of the paper): a teacher trained on the grasps of each, tested on
    grasps of the same method.

    Given again, the command goes on where it was interrupted; all tables may share a folder.
    """

    def run(self) -> None:
        _check_human(*self.grasps, self.test)
        self.reproduce("retargeting")


@dataclass(frozen=True)
class PrivilegedTable(TableOptions):
    """Compare what is known of the contacts (Table V of the paper): nothing, what an encoder learns along
    the way, the truth, and what a student has learned from a teacher.

    Given again, the command goes on where it was interrupted; all tables may share a folder.
    """

    def run(self) -> None:
        self.reproduce("privileged")


@dataclass(frozen=True)
class HandsTable(TableOptions):
    """Compare hands (Table III of the paper): a student of Shadow, Faive P0 and Allegro each, trained and
    tested on the same human grasps.

    Given again, the command goes on where it was interrupted; all tables may share a folder.
    """

    def run(self) -> None:
        _check_human(*self.grasps, self.test)
        self.reproduce("hands")


def _check_human(*names: str) -> None:
    """Complain about robot grasps.

    Raises:
        FungraspError: a file holds some, or can't be read.
    """
    from fungrasp.grasps import HumanGraspSet, load_grasps

    for name in names:
        if not isinstance(load_grasps(name), HumanGraspSet):
            raise FungraspError(f"{name} holds robot grasps; this table takes human ones")


COMMAND = {
    "retargeting": RetargetingTable,
    "privileged": PrivilegedTable,
    "hands": HandsTable,
    "policies": FreePolicies,
}
