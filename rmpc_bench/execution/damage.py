"""Stored bytes that cannot be decoded: the file was damaged, or somebody else has written it."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rmpc_bench.execution.store_file import FILE, StoreError


def damage(directory: Path, text: str) -> str:
    """Return the message for a store that cannot be decoded.

    Parameters
    ----------
    directory : of the store
    text : what is wrong
    """
    return f"{directory / FILE}: the store is damaged: {text}; `rmpc-bench run --fresh` computes everything again"


@contextmanager
def decoded(directory: Path) -> Iterator[None]:
    """Report errors of a decoder as damage of the store.

    Parameters
    ----------
    directory : of the store

    Raises
    ------
    StoreError
        If the bytes do not have the form in which they are written.
    """
    try:
        yield
    except (ValueError, TypeError, KeyError, IndexError, OverflowError, RecursionError, zlib.error) as error:
        raise StoreError(damage(directory, str(error))) from None
