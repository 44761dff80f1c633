"""The grammar of claims: from text to a tree, nothing computed.

A check is a chain of comparisons, or one ``all(...)``::

    check      = chain | "all" "(" chain ")"
    chain      = sum link {link}
    link       = ("<" | "<=" | ">" | ">=" | "==") sum  |  "~" sum "+-" sum
    sum        = product {("+" | "-") product}
    product    = factor {("*" | "/") factor}
    factor     = ("+" | "-") factor  |  number ["%"]  |  "pi"  |  "never"  |  TERM
               | "(" sum ")"  |  "[" sum {"," sum} "]"  |  FUNCTION "(" sum {"," sum} ")"  |  "share" "(" chain ")"

    TERM       = QUANTITY "[" METHOD {"," PATH "=" VALUE} "]"

A term is a metric (a column over runs), a series of a design (over k), a signal or ``n_failed[METHOD]``; METHOD is
everything up to the comma or closing bracket, trimmed, and what follows names a point of a sweep.  ``5%`` is 0.05, but
a tolerance ``+- 5%`` is that share of the right side.
Inside ``share`` and ``all`` comparisons are made entry by entry, over runs or over k.
A list of numbers is a vector; of columns, or of series, and numbers it is a column, or series, of vectors.
The signals, where no metric has the name, are the true state x, the estimate x_hat and the error e = x - x_hat.  They
stand in mean, var, std and cov only, which are then taken over the runs at each k and give a series over k.  These
ensemble moments are there with ``evaluate: [runs, moments]``; exact ones count where they exist.

The functions, a line each, stand in ``claim_tree.FUNCTION_HELP``.

``never`` is inf, and never minus never is 0.  Nothing here imports NumPy or anything that does: plain ``check``
parses claims in milliseconds.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from rmpc_bench.claims.tree import (
    COMPARISONS,
    COUNTS,
    FUNCTIONS,
    Call,
    Chain,
    ClaimError,
    Expression,
    Link,
    Listing,
    Number,
    Operation,
    Term,
    terms,
)

__all__ = ["COUNTS", "Chain", "ClaimError", "Expression", "parse", "parse_expression", "terms"]

_CONSTANTS = {"pi": math.pi, "never": math.inf}
_MOST_TOKENS, _MOST_DEPTH = 400, 40
_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*(?P<percent>%)?"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*)(?:\s*\[(?P<method>[^\]]*)(?P<close>\]?))?"
    r"|(?P<symbol>\+-|<=|>=|==|[-+*/()\[\],<>~])"
)


def parse(text: str) -> Chain:
    """Read a check.

    Parameters
    ----------
    text : such as ``mean(mse[R-MPC1]) < mean(mse[S-MPC])``

    Returns
    -------
    the tree

    Raises
    ------
    ClaimError
        with the column and, for names, the nearest known one
    """
    parser = _Parser(text)
    chain = parser.everywhere() if parser.token.text == "all" else parser.chain()
    parser.finish()
    return chain


def parse_expression(text: str) -> Expression:
    """Read one expression, such as ``1 - ratio(mse[A], mse[B])``; raises as `parse` does."""
    parser = _Parser(text)
    expression = parser.sum()
    parser.finish()
    return expression


class _Token(NamedTuple):
    kind: str
    text: str
    start: int
    end: int
    method: str = ""
    percent: bool = False


def _tokenise(text: str) -> list[_Token]:
    tokens: list[_Token] = []
    place = 0
    while True:
        place += len(text[place:]) - len(text[place:].lstrip())
        if place == len(text):
            return [*tokens, _Token("end", "", place, place)]
        match = _TOKEN.match(text, place)
        if match is None:
            raise ClaimError(place + 1, f"unexpected {text[place]!r}")
        kind, method = str(match.lastgroup), (match["method"] or "").strip()
        if match["number"]:
            kind = "number"
        elif match["method"] is not None:
            kind = "term"
            if not match["close"] or not method:
                raise ClaimError(place + 1, f"{match['name']}[...] needs a method and a closing bracket")
        word = match["number"] or match["name"] or match["symbol"]
        tokens.append(_Token(kind, word, place, match.end(), method, bool(match["percent"])))
        if len(tokens) > _MOST_TOKENS:
            raise ClaimError(place + 1, f"longer than {_MOST_TOKENS} words; split the check into a list")
        place = match.end()


class _Parser:
    """Recursive descent; one method per rule of the grammar."""

    def __init__(self, text: str) -> None:
        self.text, self.tokens = text, _tokenise(text)
        self.position = self.depth = 0

    @property
    def token(self) -> _Token:
        return self.tokens[self.position]

    def next(self) -> _Token:
        self.position += 1
        return self.tokens[self.position - 1]

    def accept(self, *symbols: str) -> str:
        if self.token.kind == "symbol" and self.token.text in symbols:
            return self.next().text
        return ""

    def expect(self, symbol: str) -> None:
        if not self.accept(symbol):
            raise self.error(f"expected {symbol!r}")

    def error(self, message: str) -> ClaimError:
        got = f"{self.token.text!r}" if self.token.text else "the end"
        return ClaimError(self.token.start + 1, f"{message} (got {got})")

    def finish(self) -> None:
        if self.token.kind != "end":
            raise self.error("expected the end")

    def since(self, start: int) -> str:
        return self.text[start : self.tokens[self.position - 1].end]

    def everywhere(self) -> Chain:
        start = self.next().start
        self.expect("(")
        chain = self.chain()
        self.expect(")")
        return Chain(chain.links, self.since(start), everywhere=True)

    def chain(self) -> Chain:
        start = first = self.token.start
        left, links = self.sum(), []
        while operator := self.accept(*COMPARISONS):
            middle = self.token.start
            right, tolerance = self.sum(), None
            if operator == "~":
                self.expect("+-")
                tolerance = self.sum()
            relative = isinstance(tolerance, Number) and tolerance.percent
            links.append(Link(left, operator, right, tolerance, relative, self.since(start)))
            left, start = right, middle
        if not links:
            raise self.error(f"expected a comparison, one of {' '.join(COMPARISONS)}")
        return Chain(tuple(links), self.since(first))

    def sum(self) -> Expression:
        left = self.product()
        while operator := self.accept("+", "-"):
            left = Operation(operator, left, self.product())
        return left

    def product(self) -> Expression:
        left = self.factor()
        while operator := self.accept("*", "/"):
            left = Operation(operator, left, self.factor())
        return left

    def factor(self) -> Expression:
        self.depth += 1
        if self.depth > _MOST_DEPTH:
            raise self.error(f"nested deeper than {_MOST_DEPTH} levels")
        sign = self.accept("+", "-")
        found = Operation(sign, Number(0.0), self.factor()) if sign else self.atom()
        self.depth -= 1
        return found

    def atom(self) -> Expression:
        if self.accept("("):
            inner = self.sum()
            self.expect(")")
            return inner
        if self.accept("["):
            return self.listing()
        token = self.token
        if token.kind not in ("number", "name", "term"):
            raise self.error("expected a number, a term such as mse[METHOD] or a function")
        self.position += 1
        if token.kind == "number":
            if math.isinf(float(token.text)):
                raise ClaimError(token.start + 1, f"{token.text} is too large; infinity is written never")
            return Number(float(token.text) / (100 if token.percent else 1), token.percent)
        if token.kind == "term":
            return self.term(token)
        if self.accept("("):
            return self.call(token)
        if token.text in _CONSTANTS:
            return Number(_CONSTANTS[token.text])
        if token.text in FUNCTIONS:
            raise self.error(f"{token.text} is a function: expected '('")
        raise ClaimError(token.start + 1, f"{token.text!r} needs a method: {token.text}[METHOD]")

    def term(self, token: _Token) -> Term:
        method, *coordinates = (part.strip() for part in token.method.split(","))
        point = [tuple(side.strip() for side in part.partition("=")[::2]) for part in coordinates]
        if not method or not all(path and value for path, value in point):
            raise ClaimError(token.start + 1, f"{token.text}[...] is {token.text}[METHOD, path=value, ...]")
        return Term(token.text, method, tuple((path, value) for path, value in point))

    def listing(self) -> Listing:
        start, items = self.token.start, self.arguments("]")
        lengths = {len(item.items) if isinstance(item, Listing) else -1 for item in items}
        nested = any(isinstance(part, Listing) for item in items if isinstance(item, Listing) for part in item.items)
        if len(lengths) > 1 or nested:
            raise ClaimError(start + 1, "a list has numbers, or rows of the same length")
        return Listing(items)

    def call(self, name: _Token) -> Call:
        if name.text not in FUNCTIONS:
            raise ClaimError(name.start + 1, _unknown(name.text))
        if name.text == "all":
            raise ClaimError(name.start + 1, "all(...) is a check of its own, not a part of one")
        if name.text == "share":
            chain = self.chain()
            self.expect(")")
            return Call(name.text, (chain,))
        arguments = self.arguments(")")
        if len(arguments) != FUNCTIONS[name.text]:
            wanted = f"takes {FUNCTIONS[name.text]} argument(s), got {len(arguments)}"
            raise ClaimError(name.start + 1, f"{name.text} {wanted}")
        return Call(name.text, arguments)

    def arguments(self, close: str) -> tuple[Expression, ...]:
        items = [self.sum()]
        while self.accept(","):
            items.append(self.sum())
        self.expect(close)
        return tuple(items)


def _unknown(name: str) -> str:
    from difflib import get_close_matches  # only an error pays for it

    near = get_close_matches(name, FUNCTIONS, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"known: {' '.join(sorted(FUNCTIONS))}"
    return f"{name!r} is not a known function; {hint}"
