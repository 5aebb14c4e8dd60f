"""Check whether fingers touch the object and objects rest on the table, and in which convention they do.

All conventions of ``grasps.conversion`` are tested; the one that explains most grasps is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.grasps.contacts import CONTACT_REACH, link_points
from fungrasp.grasps.conversion import POSES, UNITS, UP, Convention, converted
from fungrasp.grasps.human_hand import LINK_RADII
from fungrasp.objects import ObjectModel
from fungrasp.objects.mesh_file import mesh_doubts

REST_ERROR = 0.02
"""Largest distance of an object at rest from the table [m]."""

TIPS = [4, 8, 20]
"""Indices in ``HUMAN_JOINTS`` of the tips of index finger, middle finger and thumb."""

HELD = 0.05
"""Largest mean distance of the fingertips from the object [m]."""

TIP_ERROR = 0.005
"""Standard deviation of a tracked fingertip's position relative to the object [m]."""

EVIDENCE = 2.0
"""Smallest reduction of the summed errors by another convention, in standard deviations of the sum."""

FARTHEST = 0.05
"""Largest error of one grasp in this sum [m], so that single outliers do not decide."""

AGREE = 2 / 3
"""Share of the grasps with a clear difference that must support the other convention."""

EXPLAINED = 0.8
"""Share of the grasps in which fingers and table must fit in another convention."""

SURFACE_SAMPLES = 3000
"""Number of points on each object's surface."""

TRIED = 64
"""Number of evenly spread grasps for a first test of conventions, before the test on all grasps."""


@dataclass(frozen=True)
class Remark:
    """A fault of some grasps."""

    words: str
    """Description of the fault."""
    rows: np.ndarray
    """Indices of these grasps, shape [R]."""
    fatal: bool = False
    """Whether results for these grasps would be meaningless."""
    scene: bool = False
    """Whether the object's mesh is needed to notice the fault."""

    def __str__(self) -> str:
        return f"{rows_in_words(self.rows)}: {self.words}"


def rows_in_words(rows: np.ndarray) -> str:
    """Return "grasp 3" or "grasps 1, 4, 5 and 20 more"."""
    if len(rows) == 1:
        return f"grasp {rows[0]}"
    shown = ", ".join(str(row) for row in rows[:6])
    return f"grasps {shown}" + (f" and {len(rows) - 6} more" if len(rows) > 6 else "")


def _some_of(names: list[str]) -> str:
    """Join at most six names."""
    return ", ".join(names[:6]) + (" and others" if len(names) > 6 else "")


def scene_is_sound(arrays: Mapping[str, np.ndarray]) -> bool:
    """Return whether names of objects, poses and joints are given, have the right shapes and are finite."""
    count = len(arrays.get("hand_joints", ()))
    shapes = {"object_name": (count,), "object_pose": (count, 7), "hand_joints": (count, 21, 3)}
    if "object_rest_pose" in arrays:
        shapes["object_rest_pose"] = (count, 7)
    for name, shape in shapes.items():
        array = arrays.get(name, np.zeros(()))
        if array.shape != shape or array.dtype.kind not in ("US" if name == "object_name" else "fiu"):
            return False
        if name != "object_name" and not np.isfinite(array).all():
            return False
    return all(
        (np.linalg.norm(arrays[name][:, 3:].astype(float), axis=1) > 0.5).all()
        for name in POSES
        if name in arrays
    )


@dataclass(frozen=True)
class _Fit:
    """Errors between hands, objects and table in M grasps."""

    gap: np.ndarray
    """Mean distance of the tips ``TIPS`` from the object's surface [m], shape [M]."""
    height: np.ndarray
    """Height of the resting object's lowest point above the table [m], shape [M]; 0 without a rest pose."""

    @property
    def errors(self) -> np.ndarray:
        """Sum of both errors, each clipped at ``FARTHEST`` [m], shape [M]."""
        return np.minimum(self.gap, FARTHEST) + np.minimum(np.abs(self.height), FARTHEST)

    @property
    def good(self) -> np.ndarray:
        """Whether both errors are within their limits, shape [M] bool."""
        return (self.gap <= HELD) & (np.abs(self.height) <= REST_ERROR)


# Messages by changed field of the convention.
REASONS = {
    "quaternion": "quaternions are xyzw, not wxyz",
    "rotation": "rotations are transposed",
    "pose": "poses are of the world in the object frame",
    "joints_frame": "the joints are in the object's frame",
    "object_unit": "the objects' positions are in {object_unit}",
    "up": "the world's {up} points up",
    "table_height": "the table top is at {table_height:.3f} m",
}


@dataclass(frozen=True)
class GraspScene:
    """Hands and known objects of grasps, in their original convention."""

    arrays: Mapping[str, np.ndarray]
    """Fields of all N grasps, with unit quaternions."""
    objects: Mapping[str, ObjectModel]
    """Known objects by name."""
    rows: np.ndarray
    """Indices of the grasps of known objects, shape [M]."""
    held_at_rest: np.ndarray
    """Which of these have the same held and rest pose, shape [M] bool."""
    surfaces: Mapping[str, tuple[KDTree, np.ndarray]]
    """Points on each known object's surface, and the vertices of its convex hull [m], shape [C, 3]."""
    doubtful: frozenset[str] = frozenset()
    """Objects whose meshes have an odd size or a piece of the table; they do not count for the convention."""

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray], objects: Mapping[str, ObjectModel]) -> GraspScene:
        """Create a scene from fields for which ``scene_is_sound`` holds, and known objects by name."""
        import trimesh

        sound = {name: arrays[name] for name in ("object_name", "hand_joints")}
        for name in set(POSES) & set(arrays):
            pose = arrays[name].astype(float)
            norm = np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
            sound[name] = np.concatenate([pose[:, :3], pose[:, 3:] / norm], axis=1)
        rows = np.flatnonzero(np.isin(arrays["object_name"].astype(str), list(objects)))
        rest = sound.get("object_rest_pose", sound["object_pose"])
        same = np.abs(sound["object_pose"] - rest).max(axis=1, initial=0) < 1e-4
        surfaces = {}
        for name in set(arrays["object_name"][rows].tolist()):
            model = objects[str(name)]
            tree = KDTree(trimesh.sample.sample_surface(model.mesh, SURFACE_SAMPLES, seed=0)[0])
            surfaces[str(name)] = (tree, np.unique(model.hull.reshape(-1, 3), axis=0))
        doubtful = frozenset(n for n in surfaces if any(mesh_doubts(objects[n].vertices, objects[n].faces)))
        return cls(sound, objects, rows, same[rows], surfaces, doubtful)

    def untested(self) -> list[str]:
        """Return messages about omitted tests."""
        unknown = sorted(set(self.arrays["object_name"].astype(str).tolist()) - set(self.objects))
        words = []
        if unknown:
            words.append(
                "whether fingers touch what they hold and objects stand on the table: the meshes of "
                f"{_some_of(unknown)} are not given (--objects)"
            )
        if self.doubtful:
            words.append(
                f"in which convention the poses of {_some_of(sorted(self.doubtful))} are: the meshes have an "
                "odd size or a piece of the table, see the warnings"
            )
        return words

    def convention(self, of_hands: Convention) -> tuple[Convention, list[Remark]]:
        """Return the convention in which hands, objects and table fit best, and remarks.

        of_hands: convention found from the joints alone.
        """
        best, remarks = of_hands, []
        if self._trusted.any():
            best, remarks = self._only(self._trusted)._told_by_scene(of_hands)
        return self._with_rest(best, self._fit(best), remarks)

    def contact_remarks(self, convention: Convention, flags: np.ndarray | None) -> list[Remark]:
        """Report grasps whose annotated contacts are far from the object. flags: contacts, shape [N, 16]."""
        if flags is None or flags.shape != (len(self.arrays["hand_joints"]), len(LINK_RADII)):
            return []
        scene = converted({n: a[self.rows] for n, a in self.arrays.items()}, convention)
        gaps = np.zeros((len(self.rows), len(LINK_RADII)))
        for name, (tree, _) in self.surfaces.items():
            rows = np.flatnonzero(self.arrays["object_name"][self.rows].astype(str) == name)
            points = link_points(scene["hand_joints"][rows])
            local = inverse_transform_points(scene["object_pose"][rows], points.reshape(len(rows), -1, 3))
            gaps[rows] = tree.query(local)[0].reshape(points.shape[:3]).min(axis=2) - LINK_RADII
        # The palm is wide, and its points do not cover it.
        far = (flags[self.rows].astype(bool) & (gaps > CONTACT_REACH))[:, 1:]
        if not far.any():
            return []
        words = (
            f"links that are said to touch are up to {1e3 * gaps[:, 1:][far].max():.0f} mm from the object: "
            "are the contacts in the order of HUMAN_LINKS, and hand and object in one frame?"
        )
        return [Remark(words, self.rows[far.any(axis=1)], scene=True)]

    @property
    def _trusted(self) -> np.ndarray:
        """Which grasps have objects without doubts, shape [M] bool."""
        return ~np.isin(self.arrays["object_name"][self.rows].astype(str), list(self.doubtful))

    def _told_by_scene(self, of_hands: Convention) -> tuple[Convention, list[Remark]]:
        """Return the best convention, and a remark if it differs from ``of_hands``."""
        best, found = of_hands, self._fit(of_hands)
        told, some = [], self._some()
        for _ in range(3):
            now = some._fit(best)
            candidates = [c for c in some._candidates(best) if some._explains(some._fit(c), now)]
            better = [(c, fit) for c in candidates if self._explains(fit := self._fit(c), found)]
            if not better:
                break
            chosen, fit = min(better, key=lambda pair: pair[1].errors.sum())
            told.append(found.errors - fit.errors > -TIP_ERROR)
            best, found = chosen, fit
        if best is not of_hands and found.good.mean() < EXPLAINED:
            return of_hands, []
        changes = {n: v for n, v in best.changes.items() if n not in of_hands.changes}
        if not changes:
            return best, []
        reasons = " and ".join(REASONS[name].format(**changes) for name in changes)
        rows = self.rows[np.logical_and.reduce(told)]
        return best, [Remark(f"fingers, objects and table fit only if {reasons}", rows, True, True)]

    def _some(self) -> GraspScene:
        """Return a scene of at most ``TRIED`` grasps."""
        return self._only(
            np.unique(np.linspace(0, len(self.rows) - 1, min(TRIED, len(self.rows))).astype(int))
        )

    def _only(self, chosen: np.ndarray) -> GraspScene:
        """Return a scene of some grasps. chosen: indices into ``rows`` or a mask."""
        return replace(self, rows=self.rows[chosen], held_at_rest=self.held_at_rest[chosen])

    def _with_rest(
        self, best: Convention, fit: _Fit, remarks: list[Remark]
    ) -> tuple[Convention, list[Remark]]:
        """Add the faults that remain in the best convention; set its ``rest_pose``."""
        apart, off = fit.gap > HELD, np.abs(fit.height) > REST_ERROR
        in_air = off & self.held_at_rest & self._trusted
        if apart.any():
            words = f"the fingertips are on average {1e3 * fit.gap[apart].max():.0f} mm from what they hold"
            remarks.append(Remark(words, self.rows[apart], True, True))
        if in_air.any():
            words = (
                "the rest pose is the pose in which the object is held, up to "
                f"{1e3 * np.abs(fit.height[in_air]).max():.0f} mm off the table"
            )
            remarks.append(Remark(words, self.rows[in_air], True, True))
            if 2 * in_air.sum() > len(in_air):
                best = replace(best, rest_pose="settled")
        off &= ~in_air
        if off.any():
            words = (
                f"at rest the object is up to {1e3 * np.abs(fit.height[off]).max():.0f} mm off the table: "
                "check that z points up, that the table top is at z = 0 and that the mesh fits"
            )
            far = off & (np.abs(fit.height) > HELD)
            fatal = 2 * int(far.sum()) > len(self.arrays["object_name"])
            remarks.append(Remark(words, self.rows[off], fatal, True))
        return best, remarks

    def _candidates(self, now: Convention) -> list[Convention]:
        """Return conventions that differ in one value; another axis may come with a table height."""
        changes: list[dict[str, str]] = [
            {"quaternion": "xyzw"},
            {"rotation": "transposed"},
            {"pose": "world-in-object"},
            {"joints_frame": "object"},
            *({"object_unit": unit} for unit in UNITS if unit != now.unit),
        ]
        candidates = [replace(now, **c) for c in changes if not c.keys() & now.changes.keys()]
        for up in UP if now.up == "z" and not now.table_height else ():
            turned = replace(now, up=up)
            if up != "z":
                candidates.append(turned)
            heights = self._fit(turned).height
            if len(heights) >= 3 and abs(np.median(heights)) > TIP_ERROR:
                candidates.append(replace(turned, table_height=round(float(np.median(heights)), 4)))
        return candidates

    def _explains(self, fit: _Fit, now: _Fit) -> bool:
        """Return whether another convention fits better by more than measurement errors."""
        gain = now.errors - fit.errors
        telling = np.abs(gain) > 0.5 * TIP_ERROR
        return bool(
            gain.sum() > EVIDENCE * TIP_ERROR * np.sqrt(len(gain))
            and (gain[telling] > 0).sum() >= AGREE * telling.sum()
        )

    def _fit(self, convention: Convention) -> _Fit:
        scene = converted({n: a[self.rows] for n, a in self.arrays.items()}, convention)
        names = scene["object_name"].astype(str)
        gap, height = np.zeros(len(names)), np.zeros(len(names))
        for name in set(names.tolist()):
            rows = np.flatnonzero(names == name)
            local = inverse_transform_points(scene["object_pose"][rows], scene["hand_joints"][rows][:, TIPS])
            tree, corners = self.surfaces[name]
            gap[rows] = tree.query(local)[0].mean(axis=1)
            if "object_rest_pose" in scene:
                height[rows] = transform_points(scene["object_rest_pose"][rows], corners)[..., 2].min(axis=1)
        return _Fit(gap, height)
