"""Options shared by several commands."""

from __future__ import annotations

import sys
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
    from fungrasp.robots.stop_switch import StopSwitch
    from fungrasp.simulation import BufferSizes, Device

CellName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
"""A built-in robot cell, or a TOML file."""


@dataclass(frozen=True, kw_only=True)
class ObjectsOption:
    """Option for meshes."""

    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""


@dataclass(frozen=True, kw_only=True)
class GraspsOption(ObjectsOption):
    """Options for grasps and the meshes of their objects."""

    grasps: str = "builtin"
    """A grasp file (.npz), or "builtin"."""


@dataclass(frozen=True, kw_only=True)
class MirrorOption:
    """Option for mirrored grasps."""

    mirror: bool = False
    """First mirror human grasps and their objects (right to left hands or vice versa). Mirrored objects are
    named <name>_mirrored."""


@dataclass(frozen=True, kw_only=True)
class ThreadsOption:
    """Option for the number of threads."""

    threads: int = 0
    """Number of threads; 0 means all processors. Results do not depend on it."""


@dataclass(frozen=True, kw_only=True)
class ClusterOption:
    """Option for a Ray cluster."""

    ray: tuple[str, ...] | None = None
    """Run on a Ray cluster at this address ("auto": this machine's cluster); without an address, on all local
    processors. Results are the same. File paths must be the same on every machine."""

    @property
    def cluster(self) -> RayCluster | None:
        """Requested cluster; None without ``--ray``.

        Raises:
            FungraspError: there is more than one address.
        """
        from fungrasp.core.jobs import RayCluster

        if self.ray is not None and len(self.ray) > 1:
            raise FungraspError(f"--ray takes one address, not {len(self.ray)}")
        return None if self.ray is None else RayCluster(*self.ray)


def device_and_buffers(
    device: str | None, buffers: tuple[int, int] | None
) -> tuple[Device, BufferSizes | None]:
    """Return the device, by default a GPU if one is found, and the buffer sizes.

    Raises:
        FungraspError: a value is invalid, or software for the device is missing.
    """
    from fungrasp.simulation import BufferSizes, found_device
    from fungrasp.simulation.warp_device import open_warp

    found = found_device(device)
    if found != "cpu":
        open_warp(found)
    return found, None if buffers is None else BufferSizes(*buffers)


def print_use(cluster: RayCluster | None) -> None:
    """Print how much of a cluster was used, if there was one."""
    if cluster is not None and cluster.use is not None:
        print(f"on the cluster: {cluster.use.words}", file=sys.stderr)


def optional_value(metavar: str, default: str, what: str) -> Any:
    """Return an annotation of ``str | None`` for an option with zero or one values.

    Args:
        metavar: name of the value in the help.
        default: value if none follows the option.
        what: name of the value in the error for several values, such as "folder".
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
"""Type of an option ``--json FILE``; without a file, JSON goes to stdout."""


def json_path(json: str | None) -> Path | None:
    """Return the file of a ``JsonOut``; None for stdout or no JSON."""
    return None if json is None or json == STDOUT else Path(json)


def wired_cell(name: str) -> tuple[RobotCell, Hand]:
    """Load a cell, which must not be a twin, and its hand."""
    from fungrasp.hands import load_hand
    from fungrasp.robots.assembly import is_twin
    from fungrasp.robots.cell import load_cell

    cell = load_cell(name if Path(name).suffix != ".toml" else Path(name))
    if is_twin(cell):
        raise FungraspError(f"cell '{cell.name}' is a twin: it has no devices to connect to")
    return cell, load_hand(cell.hand)


def ask_before_motion(switch: StopSwitch, what: str) -> None:
    """Ask the operator whether to move a device, and print how to stop it. what: motion, as a phrase.

    Raises:
        FungraspError: the answer is not "yes", or there is no terminal.
    """
    question = f"This will {what}. Nobody within reach, a hand on the emergency stop? Type 'yes': "
    try:
        answer = switch.ask(question)
    except EOFError:
        raise FungraspError("this moves a robot and asks first: it needs a terminal") from None
    if answer.lower() != "yes":
        raise FungraspError("not confirmed: nothing has moved")
    sys.stderr.write(f"to stop: {switch.ways}\n")
