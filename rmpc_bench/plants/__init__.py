"""What is true in the simulation."""
