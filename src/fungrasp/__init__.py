"""fungrasp: a human grasp in, a robot grasp that lifts the object out.

Four nouns carry the system: ``HumanGrasp``, ``RobotGrasp``, policy, ``Trajectory``. See docs/architecture.md.
"""

__version__ = "0.1.0"
