"""Tables of stored results for the screen and for files."""
