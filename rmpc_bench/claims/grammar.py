"""The grammar of claims, on top of arithmetic: from text to a tree, nothing computed.

A check is a chain of comparisons, or one ``all(...)``::

    check    = chain | "all" "(" chain ")"
    chain    = sum link {link}
    link     = ("<" | "<=" | ">" | ">=" | "==") sum  |  "~" sum "+-" sum
    atom     = number | named | "(" sum ")" | "[" sum {"," sum} "]"
    named    = "pi" | "inf" | term | FUNCTION "(" sum {"," sum} ")" | "share" "(" chain ")"
    term     = QUANTITY "[" METHOD {"," PATH "=" VALUE} "]"

`sum` and what is below it are the rules of `expressions.arithmetic`; ``+-`` is one symbol here.
A term is a metric (a column over runs), a series of a design (over k), a signal or ``n_failed[METHOD]``; METHOD is
everything up to the comma or closing bracket, trimmed, and what follows names a point of a sweep.  ``5%`` is 0.05, but
a tolerance ``+- 5%`` is that share of the right side.
Inside ``share`` and ``all`` comparisons are made entry by entry, over runs or over k.
A list of numbers is a vector; of columns, or of series, and numbers it is a column, or series, of vectors.
The signals, where no metric has the name, are the state x, the estimate x_hat and the error e = x - x_hat.  They
stand in mean, var, std and cov only, which are then taken over the runs at each k and give a series over k.  These
ensemble moments exist with ``evaluate: [runs, moments]``; exact ones count where they exist.

``FUNCTION_HELP`` has a line on each function.

``inf`` stands for what did not occur in a run, such as settling; inf - inf is 0.  Nothing here imports NumPy or
anything that does: plain ``check`` parses claims in milliseconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache

from rmpc_bench.expressions.arithmetic import ArithmeticParser, Call, Node, Number, Percent, unknown_name
from rmpc_bench.expressions.tokens import ExpressionError, Token

__all__ = ["COUNTS", "Chain", "ExpressionError", "parse", "parse_expression", "terms"]


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
    "excess": ("a, b", "max z'az / z'bz of symmetric matrices: at most 1 if b - a is positive semidefinite"),
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
    point: tuple[tuple[str, str], ...] = ()  # path and text of the value, as written


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


_CONSTANTS = {"pi": math.pi, "inf": math.inf}


def parse(text: str) -> Chain:
    """Read a check."""
    parser = _ClaimParser(text)
    chain = parser.everywhere() if parser.token.text == "all" else parser.chain()
    parser.finish()
    return chain


def parse_expression(text: str) -> Node:
    """Read one expression, such as ``1 - ratio(mse[A], mse[B])``; raises as `parse` does."""
    parser = _ClaimParser(text)
    expression = parser.sum()
    parser.finish()
    return expression


class _ClaimParser(ArithmeticParser):
    """Arithmetic with terms, lists, functions and comparisons."""

    SYMBOLS = (*ArithmeticParser.SYMBOLS, "[", "]", ",", "+-", *COMPARISONS)
    OPERAND = "a number, a term such as mse[METHOD] or a function"
    INFINITY = "inf"
    MAX_DEPTH = 40
    MAX_TOKENS = 400

    def everywhere(self) -> Chain:
        """Read ``everywhere = "all" "(" chain ")"``."""
        start = self.tokens.next().start
        if self.token.text != "(":
            raise self.unexpected("'('")
        chain = self.chain_in_parentheses()
        return Chain(chain.links, self.tokens.since(start), everywhere=True)

    def chain(self) -> Chain:
        """Read ``chain = sum link {link}``."""
        start = first = self.token.start
        left, links = self.sum(), []
        while operator := self.tokens.accept(*COMPARISONS):
            middle = self.token.start
            right, tolerance = self.sum(), None
            if operator.text == "~":
                if not self.tokens.accept("+-"):
                    raise self.unexpected("'+-'")
                tolerance = self.sum()
            text = self.tokens.since(start)
            links.append(Link(left, operator.text, right, tolerance, text, column=operator.column))
            left, start = right, middle
        if not links:
            known, before = ", ".join(COMPARISONS), self.tokens.since(first)
            raise self.unexpected(f"a comparison ({known}) after {before}")
        return Chain(tuple(links), self.tokens.since(first), column=links[0].column)

    def chain_in_parentheses(self) -> Chain:
        """Read ``"(" chain ")"``."""
        opening = self.open()
        chain = self.chain()
        self.close(opening, ")")
        return chain

    def atom(self) -> Node:
        """Read ``atom = list | what arithmetic knows``."""
        return self.listing() if self.token.text == "[" else super().atom()

    def listing(self) -> Listing:
        """Read ``list = "[" sum {"," sum} "]"``."""
        column, items = self.token.column, self.several("]")
        lengths = {len(item.items) if isinstance(item, Listing) else -1 for item in items}
        nested = any(isinstance(part, Listing) for item in items if isinstance(item, Listing) for part in item.items)
        if len(lengths) > 1 or nested:
            raise ExpressionError(column, "a list has numbers, or rows of the same length")
        return Listing(items, column=column)

    def several(self, closing: str) -> tuple[Node, ...]:
        """Read expressions between brackets, separated by commas."""
        opening = self.open()
        items = [self.sum()]
        while self.tokens.accept(","):
            items.append(self.sum())
        self.close(opening, closing)
        return tuple(items)

    def named(self, token: Token) -> Node:
        """Read ``named = constant | term | function "(" ... ")"``."""
        if self.token.text == "[":
            return self.term(token)
        if self.token.text == "(":
            return self.call(token)
        if token.text in _CONSTANTS:
            return Number(_CONSTANTS[token.text], column=token.column)
        if token.text in FUNCTIONS:
            raise self.unexpected(f"'(' after the function {token.text}")
        raise ExpressionError(token.column, f"{token.text!r} needs a method: {token.text}[METHOD]")

    def term(self, name: Token) -> Term:
        """Read ``term = QUANTITY "[" METHOD {"," PATH "=" VALUE} "]"``."""
        inside = self.tokens.until("]")
        if inside is None or not inside.strip():
            raise ExpressionError(name.column, f"{name.text}[...] needs a method and a closing bracket")
        method, *coordinates = (part.strip() for part in inside.split(","))
        point = [tuple(side.strip() for side in part.partition("=")[::2]) for part in coordinates]
        if not method or not all(path and value for path, value in point):
            raise ExpressionError(name.column, f"{name.text}[...] is {name.text}[METHOD, path=value, ...]")
        return Term(name.text, method, tuple((path, value) for path, value in point), column=name.column)

    def call(self, name: Token) -> Call:
        """Read ``call = FUNCTION "(" sum {"," sum} ")" | "share" "(" chain ")"``."""
        if name.text not in FUNCTIONS:
            raise unknown_name(name, "function", sorted(FUNCTIONS))
        if name.text == "all":
            raise ExpressionError(name.column, "all(...) is a check of its own, not a part of one")
        if name.text == "share":
            return Call(name.text, (self.chain_in_parentheses(),), column=name.column)
        arguments = self.several(")")
        if len(arguments) != FUNCTIONS[name.text]:
            wanted = f"takes {FUNCTIONS[name.text]} argument(s), got {len(arguments)}"
            raise ExpressionError(name.column, f"{name.text} {wanted}")
        return Call(name.text, arguments, column=name.column)

    def is_known(self, name: str) -> bool:
        """Whether a name may begin an operand."""
        return name in _CONSTANTS or name in FUNCTIONS
