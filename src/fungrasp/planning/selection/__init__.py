"""Which plan to follow: candidates, simulated rollouts, search."""
