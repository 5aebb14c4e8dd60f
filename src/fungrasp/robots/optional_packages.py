"""Client libraries of devices: each is an extra of its own and is imported only when its device is used."""

from __future__ import annotations

import importlib
from types import ModuleType

from fungrasp.robots.device import RobotError


def import_client(module: str, extra: str, device: str) -> ModuleType:
    """Import a client library.

    Args:
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


def import_emulators(module: str) -> ModuleType:
    """Import a module of the emulated devices, a package of its own beside this one (``emulators/``).

    Args:
        module: of the package ``fungrasp_emulators``.

    Raises:
        RobotError: it is not installed.
    """
    try:
        return importlib.import_module(f"fungrasp_emulators.{module}")
    except ModuleNotFoundError as error:
        if not str(error.name).startswith("fungrasp_emulators"):
            raise RobotError(f"emulated devices need a package that is not installed ({error})") from error
        raise RobotError(
            "emulated devices are a package of their own, beside fungrasp's source: pip install ./emulators"
        ) from error
