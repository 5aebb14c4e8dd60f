"""What the built-in hands look like: housings, pads, palms and joint caps of our own, made from parameters.

They are for the eye alone; what collides stays as the hand's model has it.
"""

from fungrasp.media.hand_shells.dressing import dressed_model, dressed_spec

__all__ = ["dressed_model", "dressed_spec"]
