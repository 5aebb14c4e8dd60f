"""What comes before a robot's first grasp: steps, the person who answers, and the log."""
