"""Kinematics of arms that carry a hand."""
