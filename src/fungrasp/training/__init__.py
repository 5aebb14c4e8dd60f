"""Training: PPO for the teacher, distillation for the student."""
