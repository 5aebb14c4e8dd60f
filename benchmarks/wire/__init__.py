"""Deployments over emulated wires."""
