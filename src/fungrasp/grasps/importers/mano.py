"""Surface and joint rotations of DexYCB's hands, by smplx and the user's MANO model (mano.is.tue.mpg.de)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError

MANO_TO_OURS = np.array([0, 1, 2, 3, 4, 5, 6, 10, 11, 12, 7, 8, 9, 13, 14, 15])
"""MANO's 16 joints are wrist, index, middle, little finger, ring, thumb; ours have the ring finger before the
little one. It is its own inverse."""

COMPONENTS = 45


class ManoHand:
    """A MANO hand model. smplx unpickles the model file: use one from MANO's own site only."""

    def __init__(self, path: str | Path, side: str = "right"):
        """
        Args:
            path: folder with ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl``, or one of these files.
            side: "right" or "left".

        Raises:
            FungraspError: smplx or the model is missing, or the model can't be read.
        """
        try:
            import smplx  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise FungraspError('using a MANO model needs smplx: pip install "fungrasp[mano]"') from error
        path = Path(path)
        file = path / f"MANO_{side.upper()}.pkl" if path.is_dir() else path
        if not file.is_file():
            raise FungraspError(f"the MANO model {file} does not exist")
        try:
            # With 45 components smplx takes axis angles whatever its arguments say: they are made below.
            self._model: Any = smplx.MANO(
                str(file),
                is_rhand=side == "right",
                use_pca=False,
                num_pca_comps=COMPONENTS,
                flat_hand_mean=False,
            )
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise FungraspError(f"cannot read the MANO model {file}: {reason}") from error
        self.vertex_links = MANO_TO_OURS[self._model.lbs_weights.numpy().argmax(axis=1)]
        """Which of ``HUMAN_LINKS`` each vertex belongs to, shape [778]."""

    def pose(self, betas: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose the hand.

        Args:
            betas: shape [10].
            pose: as DexYCB's ``pose_m``: rotation vector, 45 pose components, translation [m], shape [51].

        Returns:
            vertices: [m], shape [778, 3], frame of ``pose``.
            wrist: position of the wrist joint [m], shape [3].
            rotations: of wrist and 15 joints as rotation vectors [rad], in the order of ``HUMAN_LINKS``,
                shape [16, 3].
        """
        import torch  # pyright: ignore[reportMissingImports]

        fingers = pose[3:48] @ np.asarray(self._model.np_hand_components)
        with torch.no_grad():
            output = self._model(
                betas=_row(betas),
                global_orient=_row(pose[:3]),
                hand_pose=_row(fingers),
                transl=_row(pose[48:]),
                return_full_pose=True,
            )
        rotations = output.full_pose.numpy().reshape(16, 3)[MANO_TO_OURS].astype(np.float64)
        return (
            output.vertices.numpy()[0].astype(np.float64),
            output.joints.numpy()[0, 0].astype(np.float64),
            rotations,
        )


def _row(values: np.ndarray) -> Any:
    import torch  # pyright: ignore[reportMissingImports]

    return torch.as_tensor(np.asarray(values, dtype=np.float32))[None]
