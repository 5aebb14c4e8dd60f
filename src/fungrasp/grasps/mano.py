"""The MANO hand model (Romero et al., SIGGRAPH Asia 2017). The user provides the model file
(mano.is.tue.mpg.de); no code in it is executed."""

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
"""Permutation from MANO's 16 joints (wrist, index, middle, little finger, ring, thumb) to ``HUMAN_LINKS``,
with the ring finger before the little finger. It is its own inverse."""

TIP_VERTICES = np.array([744, 320, 443, 554, 671])
"""Vertices at the tips of thumb, index, middle, ring and little finger (smplx, ``vertex_ids.py``)."""

COMPONENTS = 45
"""Size of a hand pose: rotation vectors of 15 joints, or as many principal components."""

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
            FungraspError: the model is missing or cannot be read.
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
        """Index into ``HUMAN_LINKS`` of each vertex, shape [778]."""

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
        """Return the joints of one hand [m], frame of the parameters, in the order of ``HUMAN_JOINTS``, shape
        [21, 3]. A left hand is not mirrored.

        Args:
            betas: shape parameters, at most 10.
            global_orient: rotation vector of the wrist [rad], shape [3].
            hand_pose: rotation vectors of MANO's 15 joints [rad], shape [45] or [15, 3], or up to 45
                principal components.
            transl: translation [m], shape [3].
            pca: whether ``hand_pose`` contains principal components. None: if it has less than 45 numbers.
            flat_hand: whether ``hand_pose`` is relative to the flat hand (smplx: ``flat_hand_mean=True``)
                instead of the mean pose, as in MANO and DexYCB.
            template: vertices of a person's hand at rest [m], shape [778, 3]. None: the mean hand.

        Raises:
            FungraspError: the number of parameters is wrong.
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
        """Return joints as ``joints`` does, vertices [m], shape [778, 3], and the rotation vectors of wrist
        and 15 joints in the order of ``HUMAN_LINKS`` [rad], shape [16, 3]."""
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
        # Linear blend skinning with pose-dependent corrections.
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
