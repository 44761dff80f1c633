"""Components from files of a user: their identity, loading and adapters."""
