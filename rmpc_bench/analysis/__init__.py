"""Statistics of the table of trials."""
