"""Many blocks, processes, files: from a YAML to a stored table of trials."""
