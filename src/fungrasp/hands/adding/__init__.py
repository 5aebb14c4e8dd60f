"""Conversion of foreign URDF or MJCF models to hand folders, by ``add_hand.add_hand``."""
