"""The objects that grasps name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fungrasp.core.errors import FungraspError
from fungrasp.objects.object_model import ObjectModel


def check_objects(names: Iterable[str], objects: Mapping[str, ObjectModel]) -> None:
    """Complain about objects that are missing.

    Args:
        names: of the objects that are needed.
        objects: those that are given, by name.

    Raises:
        FungraspError: names the first that is missing, and those that are given.
    """
    if not isinstance(objects, Mapping):
        raise FungraspError(
            f"expected objects by name, as fungrasp.load_objects(grasps) gives, not {type(objects).__name__}"
        )
    missing = sorted({str(name) for name in names} - set(objects))
    if missing:
        given = ", ".join(sorted(objects)) or "none"
        raise FungraspError(
            f"the object '{missing[0]}' of the grasps is not given; given: {given}. "
            "fungrasp.load_objects(grasps) loads them"
        )
