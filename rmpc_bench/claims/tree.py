"""The tree of a claim's check, and the words that its grammar knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TypeAlias

_TABLE = {
    "mean": ("x", "of a column over its runs, of a series over its samples; of a signal over the runs at each k"),
    "median": ("x", "of a column over its runs, of a series over its samples"),
    "std": ("x", "root of var"),
    "var": ("x", "divided by n - 1, over what mean is taken; of a signal the diagonal of cov"),
    "cov": ("x", "covariance matrix of a signal over the runs at each k, as cov(e[METHOD])"),
    "min": ("x", "smallest value of a column, series or list"),
    "max": ("x", "largest value of a column, series or list"),
    "quantile": ("x, q", "of a column or series, q from 0 to 1, linear between order statistics"),
    "share": ("a < b", "share of the runs, or of the samples k, in which the comparisons hold"),
    "all": ("a < b", "the comparisons hold in every run, at every k and in every entry; a check of its own"),
    "ratio": ("a, b", "of two columns the geometric mean of a/b run by run; else a/b"),
    "at": ("x, k", "sample k of a series"),
    "last": ("x", "last sample of a series"),
    "slope": ("x", "least-squares slope of a series per step"),
    "since": ("x, k", "samples of a series from k on; each keeps its number"),
    "upto": ("x, k", "samples of a series up to k; each keeps its number"),
    "entry": ("x, i", "entry i, counted from 0, of a vector or of every vector of a series or column"),
    "abs": ("x", "magnitude, entry by entry"),
    "diag": ("x", "diagonal of a matrix, or of every matrix of a series"),
    "trace": ("x", "trace of a matrix, or of every matrix of a series"),
    "det": ("x", "determinant of a matrix, or of every matrix of a series"),
    "excess": (
        "a, b",
        "max z'az / z'bz of symmetric matrices: above 1 where b does not cover a",
    ),
    "distance": ("x, centre, P", "sqrt((x - centre)' P^-1 (x - centre)): at most 1 in the ellipsoid of P"),
}
FUNCTIONS = {name: arguments.count(",") + 1 for name, (arguments, _) in _TABLE.items()}
"""Function of the grammar -> number of its arguments."""
FUNCTION_HELP: Mapping[str, str] = {name: f"{name}({arguments}): {line}" for name, (arguments, line) in _TABLE.items()}
"""Function of the grammar -> how it is written, a colon, and what it is, in one line."""
COMPARISONS = ("<", "<=", ">", ">=", "==", "~")
COUNTS = ("n_failed",)
"""Quantities of a term that are neither a metric nor a series: they exist for every method."""
SIGNALS = ("x", "x_hat", "e")
"""True state, estimate and error x - x_hat, where no metric has the name: of them only moments over the runs exist."""
MOMENTS = {"mean": "mean", "var": "cov", "std": "cov", "cov": "cov"}
"""Function of a signal -> what it reads: of e the series ``mean(e)`` or ``cov(e)``."""


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
    return {term for term, _ in uses(node)}


def uses(node: object, function: str = "") -> set[tuple[Term, str]]:
    """Collect the terms of a tree, each with the function that it is an argument of by itself; "" where of none."""
    if isinstance(node, Term):
        return {(node, function)}
    if isinstance(node, Call):
        return uses(node.arguments, node.function)
    if isinstance(node, tuple):
        return {found for part in node for found in uses(part, function)}
    if is_dataclass(node):
        return {found for field in fields(node) for found in uses(getattr(node, field.name))}
    return set()


def misuse(term: Term, function: str, *, signal: bool) -> str:
    """Say why a term cannot stand where it does.

    Parameters
    ----------
    term : a term of a check
    function : the one it is an argument of by itself; "" where of none
    signal : whether it is one of `SIGNALS`, rather than a metric or a series

    Returns
    -------
    the reason; empty where nothing is wrong
    """
    what = f"{term.quantity}[{term.method}]"
    if signal and function not in MOMENTS:
        return f"of the signal {what} only moments over the runs are known: mean({what}), var, std or cov"
    if function == "cov" and not signal:
        return f"cov needs a signal ({', '.join(SIGNALS)}, where no metric has the name), got {what}"
    return ""


def unknown_moment(term: Term, function: str) -> str:
    """Say that there are no moments of a signal, and the way out."""
    what = f"{function}({term.quantity}[{term.method}])"
    return f"{what} is not there: ensemble moments need `evaluate: [runs, moments]`"


def calls(node: object) -> list[Call]:
    """Collect the calls in a tree."""
    found = [node] if isinstance(node, Call) else []
    parts = node if isinstance(node, tuple) else ()
    if is_dataclass(node):
        parts = tuple(getattr(node, field.name) for field in fields(node))
    return found + [call for part in parts for call in calls(part)]


def functions(node: object) -> set[str]:
    """Collect the names of all functions in a tree, with the counted quantities among its terms."""
    if isinstance(node, Term):
        return {node.quantity} & {"n_failed"}
    found = {node.function} if isinstance(node, Call) else set()
    parts = node if isinstance(node, tuple) else ()
    if is_dataclass(node):
        parts = tuple(getattr(node, field.name) for field in fields(node))
    return found.union(*(functions(part) for part in parts))
