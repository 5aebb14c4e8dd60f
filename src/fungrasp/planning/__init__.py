"""Robot grasps become grasp plans: settle, approach, grip, lift."""
