"""Components from files of a user: which files may be loaded, their identity, loading and adapters."""
