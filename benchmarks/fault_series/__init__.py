"""Series of faults over every phase of a deployment."""
