"""Robots: interfaces and drivers of arms, hands and object trackers, safety filter, kinematics, twins."""
