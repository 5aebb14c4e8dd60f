"""Hands by the parameters of MANO (Romero et al., SIGGRAPH Asia 2017), with the user's own model file
(mano.is.tue.mpg.de). Nothing in the file is run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.grasps.human_hand import MANO

MANO_TO_OURS = np.array([0, 1, 2, 3, 4, 5, 6, 10, 11, 12, 7, 8, 9, 13, 14, 15])
"""MANO's 16 joints are wrist, index, middle, little finger, ring, thumb; ours have the ring finger before the
little one. It is its own inverse."""

TIP_VERTICES = np.array([744, 320, 443, 554, 671])
"""Vertices at the tips of thumb, index, middle, ring and little finger (smplx, ``vertex_ids.py``)."""

COMPONENTS = 45
"""Numbers of a hand's pose: rotation vectors of 15 joints, or as many principal components."""

_ARRAYS = {
    "v_template": (778, 3),
    "shapedirs": (778, 3, 10),
    "posedirs": (778, 3, 135),
    "J_regressor": (16, 778),
    "weights": (778, 16),
    "hands_components": (COMPONENTS, COMPONENTS),
    "hands_mean": (COMPONENTS,),
}


class ManoHand:
    """A MANO hand model.

    >>> hand = ManoHand("MANO_RIGHT.pkl")
    >>> joints = hand.joints(betas, global_orient, hand_pose, transl)  # in the order of HUMAN_JOINTS
    """

    def __init__(self, path: str | Path, side: str = "right"):
        """
        Args:
            path: folder with ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl``, or one of these files.
            side: "right" or "left".

        Raises:
            FungraspError: the model is missing, or can't be read.
        """
        path = Path(path)
        file = path / f"MANO_{side.upper()}.pkl" if path.is_dir() else path
        if not file.is_file():
            raise FungraspError(f"the MANO model {file} does not exist")
        content = load_arrays_pickle(file)
        if not isinstance(content, dict):
            raise FungraspError(f"{file} is no MANO model: it holds no fields")
        self._arrays: dict[str, np.ndarray] = {}
        for name, shape in _ARRAYS.items():
            array = np.asarray(content.get(name, np.zeros(0)))
            if array.shape != shape or array.dtype.kind not in "iuf":
                raise FungraspError(
                    f"{file} is no MANO model: '{name}' has shape {array.shape}, expected {shape}"
                )
            self._arrays[name] = array.astype(np.float64)
        parents = np.asarray(content.get("kintree_table", np.zeros((2, 0))))
        if parents.shape != (2, 16) or not all(0 <= int(p) < i for i, p in enumerate(parents[0][1:], 1)):
            raise FungraspError(f"{file} is no MANO model: 'kintree_table' is no tree of 16 joints")
        self._parents = parents[0].astype(int)
        self.vertex_links = MANO_TO_OURS[self._arrays["weights"].argmax(axis=1)]
        """Which of ``HUMAN_LINKS`` each vertex belongs to, shape [778]."""

    def joints(
        self,
        betas: ArrayLike,
        global_orient: ArrayLike,
        hand_pose: ArrayLike,
        transl: ArrayLike = (0.0, 0.0, 0.0),
        *,
        pca: bool | None = None,
        flat_hand: bool = False,
        template: np.ndarray | None = None,
    ) -> np.ndarray:
        """The 21 joints of one hand [m], shape [21, 3], in the order of ``HUMAN_JOINTS``, frame of the
        parameters. A left hand is not mirrored.

        Args:
            betas: shape of the hand, at most 10 numbers.
            global_orient: rotation vector of the wrist, shape [3].
            hand_pose: rotation vectors of MANO's 15 joints [rad], shape [45] or [15, 3]; or principal
                components, of any number.
            transl: translation [m], shape [3].
            pca: whether ``hand_pose`` are principal components; None: where they are fewer than 45.
            flat_hand: whether the pose counts from the flat hand (smplx: ``flat_hand_mean=True``), and not
                from the mean pose, as MANO's and DexYCB's do.
            template: vertices of a person's own hand at rest [m], shape [778, 3], in place of the mean one.

        Raises:
            FungraspError: a number of parameters that can't be.
        """
        return self.posed(
            betas, global_orient, hand_pose, transl, pca=pca, flat_hand=flat_hand, template=template
        )[0]

    def posed(
        self,
        betas: ArrayLike,
        global_orient: ArrayLike,
        hand_pose: ArrayLike,
        transl: ArrayLike = (0.0, 0.0, 0.0),
        *,
        pca: bool | None = None,
        flat_hand: bool = False,
        template: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``joints``; the surface's vertices [m], shape [778, 3]; and rotation vectors [rad] of wrist and 15
        joints in the order of ``HUMAN_LINKS``, shape [16, 3]. Arguments and errors as of ``joints``."""
        a: Any = self._arrays
        numbers = np.asarray(hand_pose, dtype=float).ravel()
        if len(numbers) > COMPONENTS or (pca is False and len(numbers) != COMPONENTS):
            raise FungraspError(
                f"a hand's pose has {COMPONENTS} numbers, or fewer components: not {len(numbers)}"
            )
        if pca or (pca is None and len(numbers) < COMPONENTS):
            numbers = numbers @ a["hands_components"][: len(numbers)]
        if not flat_hand:
            numbers = numbers + a["hands_mean"]
        vectors = np.concatenate([np.asarray(global_orient, dtype=float).ravel(), numbers])
        shape = np.asarray(betas, dtype=float).ravel()
        if vectors.shape != (48,) or len(shape) > 10 or np.shape(transl) != (3,):
            raise FungraspError(
                "MANO takes 10 betas at most, 3 numbers of orientation and of translation each"
            )
        if template is not None and np.shape(template) != _ARRAYS["v_template"]:
            raise FungraspError(f"a hand's vertices have shape {np.shape(template)}, expected (778, 3)")
        template = a["v_template"] if template is None else template
        template = template + a["shapedirs"][..., : len(shape)] @ shape
        rest = a["J_regressor"] @ template
        # Linear blend skinning with corrections by shape and pose.
        turns = Rotation.from_rotvec(vectors.reshape(16, 3)).as_matrix()
        bent = template + a["posedirs"] @ (turns[1:] - np.eye(3)).ravel()
        world, place = turns.copy(), rest.copy()
        for joint in range(1, 16):
            parent = self._parents[joint]
            world[joint] = world[parent] @ turns[joint]
            place[joint] = place[parent] + world[parent] @ (rest[joint] - rest[parent])
        moved = np.einsum("jab,vjb->vja", world, bent[:, None] - rest) + place
        shift = np.asarray(transl, dtype=float)
        vertices = np.einsum("vj,vja->va", a["weights"], moved) + shift
        joints = np.concatenate([place + shift, vertices[TIP_VERTICES]])[MANO]
        return joints, vertices, vectors.reshape(16, 3)[MANO_TO_OURS]
