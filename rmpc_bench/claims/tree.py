"""The tree of a claim's check, and the functions and operators of its grammar."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache

from rmpc_bench.expressions.arithmetic import Call, Node, Percent

_TABLE = {
    "mean": ("x", "mean of a column over its runs, of a series over its samples, of a signal over the runs at each k"),
    "median": ("x", "median of a column over its runs, of a series over its samples"),
    "std": ("x", "standard deviation, the root of var"),
    "var": ("x", "sample variance (n - 1) over the same index as mean; of a signal the diagonal of cov"),
    "cov": ("x", "covariance matrix of a signal over the runs at each k, as cov(e[METHOD])"),
    "min": ("x", "smallest value of a column, series or list"),
    "max": ("x", "largest value of a column, series or list"),
    "quantile": ("x, q", "quantile of a column or series, q from 0 to 1, linear between order statistics"),
    "share": ("a < b", "share of the runs, or of the samples k, in which the comparisons hold"),
    "all": ("a < b", "if the comparisons hold in all runs, k and entries; the whole check; runs can only refute it"),
    "ratio": ("a, b", "geometric mean of a/b over the runs of two columns; a/b of other values"),
    "at": ("x, k", "sample k of a series"),
    "last": ("x", "last sample of a series"),
    "slope": ("x", "least-squares slope of a series per step"),
    "since": ("x, k", "samples of a series from k on, with unchanged indices"),
    "upto": ("x, k", "samples of a series up to k, with unchanged indices"),
    "entry": ("x, i", "entry i, counted from 0, of a vector, or row i of a matrix; of every one of a series"),
    "abs": ("x", "absolute value, entry by entry"),
    "diag": ("x", "diagonal of a matrix, or of every matrix of a series"),
    "trace": ("x", "trace of a matrix, or of every matrix of a series"),
    "det": ("x", "determinant of a matrix, or of every matrix of a series"),
    "excess": (
        "a, b",
        "max z'az / z'bz of symmetric matrices: at most 1 if b - a is positive semidefinite",
    ),
    "distance": ("x, centre, P", "sqrt((x - centre)' P^-1 (x - centre)): at most 1 inside the ellipsoid of P"),
}
FUNCTIONS = {name: arguments.count(",") + 1 for name, (arguments, _) in _TABLE.items()}
"""Function of the grammar -> number of its arguments."""
FUNCTION_HELP: Mapping[str, str] = {name: f"{name}({arguments}): {line}" for name, (arguments, line) in _TABLE.items()}
"""Function of the grammar -> its usage, a colon, and its meaning, in one line."""
COMPARISONS = ("<", "<=", ">", ">=", "==", "~")
COUNTS = ("n_failed",)
"""Quantities of a term that are neither a metric nor a series: they exist for every method."""
SIGNALS = ("x", "x_hat", "e")
"""True state, estimate and error x - x_hat, if no metric has the name; only their moments over the runs exist."""
MOMENTS = {"mean": "mean", "var": "cov", "std": "cov", "cov": "cov"}
"""Function of a signal -> series that it reads: for e ``mean(e)`` or ``cov(e)``."""


@dataclass(frozen=True, order=True)
class Term(Node):
    """A metric, series or count of one method, possibly at a point of a sweep."""

    quantity: str
    method: str
    point: tuple[tuple[str, str], ...] = ()
    """Path and text of the value, as written."""


@dataclass(frozen=True)
class Listing(Node):
    """A vector, or a matrix as a list of rows."""

    items: tuple[Node, ...]


@dataclass(frozen=True)
class Link(Node):
    """One comparison; `tolerance` is that of ~, relative to the right side if it is a percentage."""

    left: Node
    operator: str
    right: Node
    tolerance: Node | None
    text: str

    @property
    def relative(self) -> bool:
        """Whether the tolerance is a share of the right side."""
        return isinstance(self.tolerance, Percent)


@dataclass(frozen=True)
class Chain(Node):
    """Comparisons that must all hold; `everywhere` if they are the argument of ``all(...)``, with the text `text`."""

    links: tuple[Link, ...]
    text: str
    everywhere: bool = False


def children(node: Node) -> Iterator[Node]:
    """Nodes directly below a node, from left to right."""
    for field in fields(node):
        value = getattr(node, field.name)
        yield from (part for part in (value if isinstance(value, tuple) else (value,)) if isinstance(part, Node))


def walk(node: Node) -> Iterator[Node]:
    """A node and all nodes below it."""
    yield node
    for child in children(node):
        yield from walk(child)


@lru_cache(maxsize=1024)
def terms(node: Node) -> frozenset[Term]:
    """Collect the terms of a tree; `COUNTS` are quantities too.  A claim asks for them in every resample."""
    return frozenset(part for part in walk(node) if isinstance(part, Term))


def calls(node: Node) -> list[Call]:
    """Collect the calls in a tree."""
    return [part for part in walk(node) if isinstance(part, Call)]


def uses(node: Node, function: str = "") -> set[tuple[Term, str]]:
    """Collect the terms of a tree, each with the function that it is an argument of by itself; "" where of none."""
    if isinstance(node, Term):
        return {(node, function)}
    inside = node.function if isinstance(node, Call) else ""
    return {found for child in children(node) for found in uses(child, inside)}


def functions(node: Node) -> set[str]:
    """Collect the names of all functions in a tree, and the counted quantities among its terms."""
    counted = {term.quantity for term in terms(node)} & set(COUNTS)
    return {call.function for call in calls(node)} | counted


def misuse(term: Term, function: str, *, signal: bool) -> str:
    """Say why a term cannot stand by itself in a function ("" for none), empty where it can."""
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
