"""Numbers from the table of trials, nothing else."""
