"""Everyday objects by parametric construction, of real sizes, with named functional parts: those that come
with the package, and what the grasp set draws."""
