"""Tables and pictures from stored results, nothing else."""
