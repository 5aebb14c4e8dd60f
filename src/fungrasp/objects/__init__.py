"""Physical objects: built-in, or from a mesh and a mass."""

from fungrasp.objects.builtin_objects import is_plain_shape, plain_shape
from fungrasp.objects.convex_decomposition import ConvexPiece, convex_pieces
from fungrasp.objects.mesh_file import load_mesh
from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.object_registry import (
    builtin_object,
    check_objects,
    load_object,
    mesh_files,
    object_from_file,
    object_names,
)
from fungrasp.objects.object_variants import (
    MIRRORED,
    mirrored_name,
    mirrored_object,
    scaled_name,
    scaled_object,
    shifted_mass,
    with_sizes,
)
from fungrasp.objects.resolved_object import ResolvedObject, object_from_mesh, resolve_object

__all__ = [
    "MIRRORED",
    "ConvexPiece",
    "ObjectModel",
    "ResolvedObject",
    "builtin_object",
    "check_objects",
    "convex_pieces",
    "is_plain_shape",
    "load_mesh",
    "load_object",
    "mesh_files",
    "mirrored_name",
    "mirrored_object",
    "object_from_file",
    "object_from_mesh",
    "object_names",
    "plain_shape",
    "resolve_object",
    "scaled_name",
    "scaled_object",
    "shifted_mass",
    "with_sizes",
]
