"""Everyday objects made by parametric construction: real sizes, real masses, named functional parts."""

from fungrasp.objects.builtin.catalogue import BUILTINS, BuiltinObject, build_builtin

__all__ = ["BUILTINS", "BuiltinObject", "build_builtin"]
