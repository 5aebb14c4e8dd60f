"""Options that several commands have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from fungrasp.cli.console import STDOUT
from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.core.jobs import RayCluster
    from fungrasp.hands import Hand
    from fungrasp.robots.cell import RobotCell
    from fungrasp.simulation import BufferSizes, Device

CellName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
"""A robot cell: a TOML file, or one that comes with the package."""


@dataclass(frozen=True, kw_only=True)
class ObjectsOption:
    """Meshes of one's own."""

    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""


@dataclass(frozen=True, kw_only=True)
class GraspsOption(ObjectsOption):
    """Which grasps, and of what."""

    grasps: str = "builtin"
    """A file of human or robot grasps, as the command takes them, or "builtin"."""


@dataclass(frozen=True, kw_only=True)
class MirrorOption:
    """Grasps of right hands for a left hand."""

    mirror: bool = False
    """Mirror human grasps and their objects first, from right hands to left hands or the other way round.
    Mirrored objects are named <name>_mirrored."""


@dataclass(frozen=True, kw_only=True)
class ThreadsOption:
    """Of this machine."""

    threads: int = 0
    """0 means all processors; the result does not depend on it."""


@dataclass(frozen=True, kw_only=True)
class ClusterOption:
    """Of many machines."""

    ray: tuple[str, ...] | None = None
    """Use a Ray cluster at this address ("auto": the one this machine belongs to); without an address, all
    processors of this machine. The results are the same. Files must have the same paths on every machine."""

    @property
    def cluster(self) -> RayCluster | None:
        """The cluster that is meant; None where ``--ray`` is not given.

        Raises:
            FungraspError: more than one address.
        """
        from fungrasp.core.jobs import RayCluster

        if self.ray is not None and len(self.ray) > 1:
            raise FungraspError(f"--ray takes one address, not {len(self.ray)}")
        return None if self.ray is None else RayCluster(*self.ray)


def device_and_buffers(
    device: str | None, buffers: tuple[int, int] | None
) -> tuple[Device, BufferSizes | None]:
    """What ``--device`` and ``--buffers`` mean: a GPU, if there is one, where no device is given.

    Args:
        buffers: contacts and rows of a world, as given.

    Raises:
        FungraspError: an impossible value, or something that the device needs is missing.
    """
    from fungrasp.simulation import BufferSizes, found_device
    from fungrasp.simulation.warp_device import open_warp

    found = found_device(device)
    if found != "cpu":
        open_warp(found)
    return found, None if buffers is None else BufferSizes(*buffers)


def print_use(cluster: RayCluster | None) -> None:
    """Say how well a cluster was used, if there was one."""
    if cluster is not None and cluster.use is not None:
        print(f"on the cluster: {cluster.use.words}")


def optional_value(metavar: str, default: str, what: str) -> Any:
    """How tyro reads an option that stands for a default where no value follows; for ``Annotated[str | None,
    ...]``.

    Args:
        metavar: of the value, in the help.
        default: where none follows.
        what: may be given only once, "folder".
    """

    def one(words: list[str]) -> str:
        if len(words) > 1:
            raise ValueError(f"give one {what}")
        return words[0] if words else default

    return tyro.constructors.PrimitiveConstructorSpec(
        nargs="*",
        metavar=metavar,
        instance_from_str=one,
        is_instance=lambda value: value is None or isinstance(value, str),
        str_from_instance=lambda value: [str(value)],
    )


JsonOut = Annotated[str | None, optional_value("[FILE]", STDOUT, "file")]
"""``--json FILE`` of a command whose answer is large; without a file it is printed, as elsewhere."""


def json_path(json: str | None) -> Path | None:
    """The file that is meant by a ``JsonOut``; None where there is none."""
    return None if json is None or json == STDOUT else Path(json)


def wired_cell(name: str) -> tuple[RobotCell, Hand]:
    """A cell of real or emulated devices, and its hand."""
    from fungrasp.hands import load_hand
    from fungrasp.robots.cell import load_cell
    from fungrasp.robots.single_devices import check_wired

    cell = load_cell(name if Path(name).suffix != ".toml" else Path(name))
    check_wired(cell)
    return cell, load_hand(cell.hand)
