"""One parser for quantities and for the checks of claims."""
