"""From a YAML to an ExperimentConfig."""
