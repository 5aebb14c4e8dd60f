"""Series of deployments on twins: Tables VI and II of the paper."""
