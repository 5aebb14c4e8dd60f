"""Deployment of grasps on robots: control loop, phases, log, rehearsal."""
