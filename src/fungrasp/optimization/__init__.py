"""Solvers and terms that every fit of a hand shares."""
