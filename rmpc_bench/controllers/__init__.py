"""Control laws: from an estimate and the coming reference to an input."""
