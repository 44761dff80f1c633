"""Plants: the true systems of the simulation."""
