"""From an ExperimentConfig to stored trials and published results."""
