"""Joints from MANO's parameters or surface, by the user's own MANO model (extra ``mano``)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.errors import FungraspError
from fungrasp.grasps.importers.mano import ManoHand
from fungrasp.grasps.joint_orders import MANO, TIP_VERTICES


class ManoJoints(ManoHand):
    """A MANO hand model that tells its 21 joints in the order of ``HUMAN_JOINTS``."""

    def of_pose(
        self,
        betas: np.ndarray,
        orientation: np.ndarray,
        fingers: np.ndarray,
        translation: np.ndarray,
        *,
        flat: bool = True,
    ) -> np.ndarray:
        """Joints [m], shape [21, 3], frame of ``translation``.

        Args:
            betas: shape [10].
            orientation: of the wrist, see ``rotation_vectors``, shape [3] or [3, 3].
            fingers: of the 15 joints in MANO's order, shape [45], [15, 3] or [15, 3, 3].
            translation: [m], shape [3].
            flat: rotations of the joints are against the flat hand (as HaMeR and WiLoR give them); else
                against the mean pose.

        Raises:
            FungraspError: a shape is another.
        """
        import torch  # pyright: ignore[reportMissingImports]

        def row(values: np.ndarray):
            return torch.as_tensor(np.asarray(values, dtype=np.float32).reshape(1, -1))

        angles = rotation_vectors(fingers, 15).ravel()
        if flat:
            # The model adds its mean pose.
            angles = angles - np.asarray(self._model.hand_mean).ravel()
        with torch.no_grad():
            output = self._model(
                betas=row(betas),
                global_orient=row(rotation_vectors(orientation, 1)),
                hand_pose=row(angles),
                transl=row(translation),
            )
        return _with_tips(output.joints.numpy()[0, :16], output.vertices.numpy()[0])

    def of_surface(self, vertices: np.ndarray) -> np.ndarray:
        """Joints [m], shape [21, 3], of a posed surface. vertices: [m], shape [778, 3]."""
        regressor = self._model.J_regressor.numpy()
        if vertices.shape != (regressor.shape[1], 3):
            raise FungraspError(f"MANO's surface has shape [778, 3], not {list(vertices.shape)}")
        return _with_tips(regressor @ vertices, vertices)


def rotation_vectors(rotations: np.ndarray, count: int) -> np.ndarray:
    """Rotation vectors [rad], shape [count, 3], of rotation vectors or matrices.

    Raises:
        FungraspError: neither 3 nor 9 numbers per rotation.
    """
    rotations = np.asarray(rotations, dtype=float)
    if rotations.size == 3 * count:
        return rotations.reshape(count, 3)
    if rotations.size == 9 * count:
        return Rotation.from_matrix(rotations.reshape(count, 3, 3)).as_rotvec()
    raise FungraspError(
        f"{count} rotations of MANO are {3 * count} numbers (rotation vectors) or {9 * count} (matrices), "
        f"not {rotations.size}; components of a PCA must be turned into rotations first"
    )


def _with_tips(joints: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    return np.concatenate([joints, vertices[TIP_VERTICES]])[MANO].astype(float)
