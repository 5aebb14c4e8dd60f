"""Physical objects from a mesh and a mass, and the built-in ones."""

from fungrasp.objects.convex_decomposition import ConvexPiece, convex_pieces
from fungrasp.objects.held_object import HeldObject, held_object
from fungrasp.objects.mesh_file import load_mesh
from fungrasp.objects.mirroring import MIRRORED, mirrored_name, mirrored_object
from fungrasp.objects.object_choice import check_objects
from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.object_registry import (
    builtin_object,
    load_object,
    mesh_files,
    object_from_file,
    object_names,
)
from fungrasp.objects.object_variants import scaled_name, scaled_object, shifted_mass, with_sizes
from fungrasp.objects.plain_shapes import is_plain_shape, plain_shape

__all__ = [
    "MIRRORED",
    "ConvexPiece",
    "HeldObject",
    "ObjectModel",
    "builtin_object",
    "check_objects",
    "convex_pieces",
    "held_object",
    "is_plain_shape",
    "load_mesh",
    "load_object",
    "mesh_files",
    "mirrored_name",
    "mirrored_object",
    "object_from_file",
    "object_names",
    "plain_shape",
    "scaled_name",
    "scaled_object",
    "shifted_mass",
    "with_sizes",
]
