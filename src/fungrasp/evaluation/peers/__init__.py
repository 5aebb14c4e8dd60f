"""Retargeting by other packages, for a comparison on the same grasps and hand; each needs its own package
(extra ``bench``)."""
