"""A hand folder from a foreign URDF or MJCF; ``add_hand.add_hand`` does it all."""
