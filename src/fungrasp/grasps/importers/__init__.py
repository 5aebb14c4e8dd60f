"""Import public data sets as human grasps. Other packages add importers by the entry point
``fungrasp.grasps``: functions from a path to a ``HumanGraspSet``."""
