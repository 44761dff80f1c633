"""Every file that is derived from stored trials."""
