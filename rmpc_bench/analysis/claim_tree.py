"""The tree of a claim's check, and the words that its grammar knows."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import TypeAlias

FUNCTIONS = {
    name: arguments
    for arguments, names in (
        (1, "mean median std var min max abs share all last slope diag trace det"),
        (2, "quantile ratio at"),
    )
    for name in names.split()
}
COMPARISONS = ("<", "<=", ">", ">=", "==", "~")
COUNTS = ("n_failed",)
"""Quantities of a term that are neither a metric nor a series: they exist for every method."""


class ClaimError(ValueError):
    """A check that cannot be read; the message begins with the column, `column` counts from 1."""

    def __init__(self, column: int, message: str) -> None:
        self.column, self.message = column, message
        super().__init__(f"column {column}: {message}")

    def __reduce__(self) -> tuple[type[ClaimError], tuple[int, str]]:
        """Pickle by column and message."""
        return type(self), (self.column, self.message)


@dataclass(frozen=True)
class Number:
    """A number; `percent` when it was written with a per cent sign, `value` being divided already."""

    value: float
    percent: bool = False


@dataclass(frozen=True, order=True)
class Term:
    """A metric, series or count of one method, possibly at a point of a sweep."""

    quantity: str
    method: str
    point: tuple[tuple[str, str], ...] = ()
    """Path and text of the value, as written."""


@dataclass(frozen=True)
class Listing:
    """A vector, or a matrix as a list of rows."""

    items: tuple[Expression, ...]


@dataclass(frozen=True)
class Operation:
    """One of + - * /; a sign is an operation on 0."""

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True)
class Call:
    """A function of its arguments."""

    function: str
    arguments: tuple[Expression | Chain, ...]


@dataclass(frozen=True)
class Link:
    """One comparison; `tolerance` belongs to ~, `relative` when it is a percentage of the right side."""

    left: Expression
    operator: str
    right: Expression
    tolerance: Expression | None
    relative: bool
    text: str


@dataclass(frozen=True)
class Chain:
    """Comparisons that must all hold; `everywhere` when they stand in ``all(...)``, as one statement `text`."""

    links: tuple[Link, ...]
    text: str
    everywhere: bool = False


Expression: TypeAlias = Number | Term | Listing | Operation | Call


def terms(node: object) -> set[Term]:
    """Collect the terms of a tree; `COUNTS` are quantities too."""
    if isinstance(node, Term):
        return {node}
    if isinstance(node, tuple):
        return {found for part in node for found in terms(part)}
    if is_dataclass(node):
        return {found for field in fields(node) for found in terms(getattr(node, field.name))}
    return set()


def functions(node: object) -> set[str]:
    """Collect the names of all functions in a tree, with the counted quantities among its terms."""
    if isinstance(node, Term):
        return {node.quantity} & {"n_failed"}
    found = {node.function} if isinstance(node, Call) else set()
    parts = node if isinstance(node, tuple) else ()
    if is_dataclass(node):
        parts = tuple(getattr(node, field.name) for field in fields(node))
    return found.union(*(functions(part) for part in parts))
