"""Human grasps written as specifications (part, task, fingers) and solved."""
