"""``fungrasp objects``: list and show objects."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from fungrasp.cli.console import Answering, CommandResult, table
from fungrasp.core.files import check_suffix

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel


@dataclass(frozen=True)
class ListObjects(Answering):
    """List the known objects."""

    objects: Path | None = None
    """A folder of further meshes to list."""

    def run(self) -> CommandResult:
        from fungrasp.objects import builtin_object, mesh_files, object_names

        models = [builtin_object(name) for name in object_names()]
        meshes = mesh_files(self.objects)
        known = [
            {"name": m.name, "parts": list(m.parts), "size": m.size, "mass": m.mass, "source": m.source}
            for m in models
        ]
        files = [{"name": name, "path": path} for name, path in meshes.items()]
        rows = [("name", "parts", "size [cm]", "mass [g]", "source")]
        rows += [
            (m.name, ", ".join(m.parts), _size(m.size), f"{m.mass * 1000:.0f}", m.source) for m in models
        ]
        rows += [(name, "", "", "", str(path)) for name, path in meshes.items()]
        return CommandResult([*known, *files], table(rows, left=None))


@dataclass(frozen=True)
class ShowObject(Answering):
    """Show an object: size, mass, inertia, parts, mesh repairs, and the convex pieces for physics."""

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|PATH")]
    """A built-in object, a mesh in --objects, or the path of a mesh file."""
    mass: float | None = None
    """Mass [kg]. Default: known for built-in objects."""
    objects: Path | None = None
    """A folder of meshes."""
    picture: Path | None = None
    """Draw the object from four sides, colored by part, to this file (.png or .jpg)."""
    pieces: bool = False
    """Color by convex piece instead of by part."""

    def run(self) -> CommandResult:
        from fungrasp.objects.object_description import describe_object

        if self.picture is not None:
            from fungrasp.media.pictures import PICTURES, draw_object

            check_suffix(self.picture, "a picture", *PICTURES)
        model, weighed = self._load()
        description = describe_object(model)
        if not weighed:
            description |= {"mass": None, "inertia": None}
        if self.picture is not None:
            draw_object(self.picture, model, self.pieces)
            print(f"wrote {self.picture}", file=sys.stderr)
        return CommandResult(description, _text(description))

    def _load(self) -> tuple[ObjectModel, bool]:
        """Load the object, with 1 kg if its mass is unknown; return it and whether the mass is known."""
        from fungrasp.objects import load_object, mesh_files, object_from_file

        if self.objects is None and Path(self.name).suffix and Path(self.name).is_file():
            return object_from_file(self.name, 1.0 if self.mass is None else self.mass), self.mass is not None
        is_mesh = self.name in mesh_files(self.objects)
        weighed = self.mass is not None or not is_mesh
        return load_object(self.name, self.mass if weighed else 1.0, self.objects), weighed


COMMAND = {"list": ListObjects, "show": ShowObject}


def _text(d: dict[str, Any]) -> str:
    mm = {key: value * 1000 for key, value in d["fidelity"].items()}
    total = sum(part["area"] for part in d["parts"].values())
    rows = [
        ("size", f"{_size(d['size'])} cm"),
        (
            "mesh",
            f"{d['vertices']} vertices, {d['faces']} faces, {'' if d['watertight'] else 'not '}watertight",
        ),
        *(("repaired", phrase) for phrase in d["repairs"]),
        ("volume", f"{d['volume'] * 1e6:.1f} cm3"),
        ("mass", "unknown: give --mass" if d["mass"] is None else f"{d['mass']:.4g} kg"),
        ("center", f"({', '.join(f'{x * 100:.2f}' for x in d['center_of_mass'])}) cm"),
    ]
    if d["inertia"] is not None:
        # Rounding errors and -0.0 become 0.
        least = 1e-9 * max(map(max, d["inertia"]))
        rounded = [[x if abs(x) > least else 0.0 for x in row] for row in d["inertia"]]
        rows += [("inertia", f"[{', '.join(f'{x:.3e}' for x in row)}] kg m2") for row in rounded]
    rows += [
        ("part", f"{name}, {part['area'] / total:.0%} of the surface") for name, part in d["parts"].items()
    ]
    rows += [
        ("pieces", f"{d['pieces']} convex"),
        ("", f"at most {mm['bulge_max']:.2f} mm outside the mesh (mean {mm['bulge_mean']:.2f})"),
        ("", f"mesh at most {mm['shrink_max']:.2f} mm outside them (mean {mm['shrink_mean']:.2f})"),
    ]
    title = f"{d['name']}: {d['source']}" if d["source"] else d["name"]
    return "\n".join([title, *(f"  {key:<9} {value}" for key, value in rows)])


def _size(size: Iterable[float]) -> str:
    return " x ".join(f"{x * 100:.1f}" for x in size)
