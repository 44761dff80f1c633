"""An issue of a component's parameters, found before any run, and the sentences that several components share."""

from __future__ import annotations

from typing import NamedTuple


class Issue(NamedTuple):
    """One thing wrong with the parameters of a component."""

    key: str
    """The YAML key to blame, with dots inside a nested one; empty for the component as a whole."""
    message: str


def no_such_component(noun: str, index: int, n: int) -> str:
    """Say that an index counts beyond the components there are: ``there is no state 3 (they count from 0 to 1)``."""
    return f"there is no {noun} {index} (they count from 0 to {n - 1})"
