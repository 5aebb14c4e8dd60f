"""Solvers and cost terms shared by all fits of hands."""
