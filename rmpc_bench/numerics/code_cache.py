"""Kernels whose compiled code could not be kept in a file; numba is not imported here, but by compiled.py."""

from __future__ import annotations

WITHOUT_FILE: list[str] = []
"""Names of the kernels that this process has compiled, or will compile, without a file of the compiled code."""


def cache_remark() -> str:
    """Return a line for the user where compiled code is not kept; empty otherwise."""
    if not WITHOUT_FILE:
        return ""
    return (
        "compiled code is not kept, as no directory for it is writable, and every process compiles it again; "
        "set NUMBA_CACHE_DIR to a writable directory"
    )
