"""Reading other people's data sets as human grasps. Other packages bring importers by the entry point
``fungrasp.grasps``: functions that take a path and return a ``HumanGraspSet``."""
