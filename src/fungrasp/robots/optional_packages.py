"""Client libraries of devices: each is an extra of its own and is imported only when its device is used."""

from __future__ import annotations

import importlib
from types import ModuleType

from fungrasp.robots.device import RobotError


def import_client(module: str, extra: str, device: str) -> ModuleType:
    """Import a client library.

    Args:
        module: name of the module.
        extra: the extra of this package that installs it.
        device: what needs it, for the message.

    Raises:
        RobotError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise RobotError(
            f'{device} needs a package that is not installed ({error}): pip install "fungrasp[{extra}]"'
        ) from error
