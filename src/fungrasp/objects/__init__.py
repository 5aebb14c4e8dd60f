"""Physical objects from a mesh and a mass, and the built-in ones."""

from fungrasp.objects.convex_decomposition import ConvexPiece, convex_pieces
from fungrasp.objects.mesh_file import load_mesh
from fungrasp.objects.mirroring import MIRRORED, mirrored_name, mirrored_object
from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.object_registry import (
    builtin_object,
    load_object,
    mesh_files,
    object_from_file,
    object_names,
)
from fungrasp.objects.object_variants import scaled_name, scaled_object, shifted_mass, with_sizes

__all__ = [
    "MIRRORED",
    "ConvexPiece",
    "ObjectModel",
    "builtin_object",
    "convex_pieces",
    "load_mesh",
    "load_object",
    "mesh_files",
    "mirrored_name",
    "mirrored_object",
    "object_from_file",
    "object_names",
    "scaled_name",
    "scaled_object",
    "shifted_mass",
    "with_sizes",
]
