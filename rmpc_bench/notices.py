"""Lines for the user that a program and a notebook need as well as the command line; they go to stderr."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """Write a line to stderr; where a program listens to the logger ``rmpc_bench``, log it there instead."""
    # Imported here, so that the names of components are listed without it.
    import logging

    logger = logging.getLogger("rmpc_bench")
    if logger.isEnabledFor(logging.INFO) and logger.hasHandlers():
        logger.info(text)
    else:
        print(text, file=sys.stderr, flush=True)
