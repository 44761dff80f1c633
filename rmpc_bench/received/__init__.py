"""The door for files that somebody else may have made: each is read here, with its types, sizes and names checked."""
