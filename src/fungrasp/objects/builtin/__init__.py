"""Everyday objects made by parametric construction: real sizes, real masses, named functional parts."""

from fungrasp.objects.builtin.catalogue import BUILTINS, Builtin, build

__all__ = ["BUILTINS", "Builtin", "build"]
