"""Lines for the user that a program and a notebook need as well as the command line; they go to stderr."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """Write a line to stderr."""
    print(text, file=sys.stderr)
