"""Controllers: they compute the input from the estimate and the future reference."""
