"""Which plan to follow: candidates, a success predictor, simulated rollouts, search."""
