"""State estimators: one method per file; the name of the file is the kind."""
