"""Two variants compared on the same grasps and worlds."""
