"""The code that computes trials, as plain data: a part of the key of every trial, not of the experiment hash."""

from __future__ import annotations

from typing import Any

import rmpc_bench


def code_version() -> dict[str, Any]:
    """Return what identifies the code that computes trials; rows of any other code are computed again."""
    return {"numerics": rmpc_bench.NUMERICS}
