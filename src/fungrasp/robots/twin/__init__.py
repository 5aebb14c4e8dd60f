"""The twin: a simulated robot cell whose true parameters nobody is told."""
