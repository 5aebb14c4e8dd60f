"""A success predictor from a policy file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.selection.success_predictor import plan_features
from fungrasp.policies.checkpoint.checkpoint_file import check_fits
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.task import GraspPlan
from fungrasp.task.features import flatten, layout


class NetworkPredictor:
    """See ``fungrasp.planning.selection.success_predictor.SuccessPredictor``."""

    def __init__(self, network: PolicyNetwork, hand: Hand, objects: Mapping[str, ObjectModel]):
        """
        Args:
            network: of a policy file of the kind "predictor".
            hand: of the plans.
            objects: by name, all that plans may be for.
        """
        self._network, self._hand, self._objects = network, hand, objects
        self.digest = network.card.sha256

    def __call__(self, plans: GraspPlan) -> np.ndarray:
        """Probability of success, shape [N].

        Raises:
            FungraspError: the network was made for another hand, other features or another rate.
        """
        parts = plan_features(plans, self._objects)
        check_fits(self._network.card, self._hand, layout(parts), (), 1 / plans.control_period)
        value, _, _ = self._network(np.nan_to_num(flatten(parts)).astype(np.float32))
        return value[:, 0]
