"""Arithmetic expressions as trees, and their parser.

    sum     = product {("+" | "-") product}
    product = signed {("*" | "/") signed}
    signed  = {"+" | "-"} atom ["%"]
    atom    = number | named | "(" sum ")"

A derived parser defines the names (`ArithmeticParser.named`) and may add rules.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from difflib import SequenceMatcher, get_close_matches
from typing import ClassVar

from rmpc_bench.expressions.tokens import ExpressionError, Token, Tokens


@dataclass(frozen=True)
class Node:
    """Node of an expression tree; two nodes are equal if their contents are, at any offset in the text."""

    column: int = field(default=0, compare=False, kw_only=True)
    """Column of the number, name, operator or function in the text, counted from 1."""


@dataclass(frozen=True)
class Number(Node):
    """A finite number, or a constant of the language."""

    value: float


@dataclass(frozen=True)
class Name(Node):
    """A free name."""

    name: str


@dataclass(frozen=True)
class Negation(Node):
    """A minus sign before an operand; an even number of signs is none."""

    operand: Node


@dataclass(frozen=True)
class Percent(Node):
    """An operand divided by 100."""

    operand: Node


@dataclass(frozen=True)
class Operand(Node):
    """An operator and its right operand."""

    operator: str
    node: Node


@dataclass(frozen=True)
class Operation(Node):
    """Sums and differences, or products and quotients, applied from left to right.

    A chain of any length is one node, so that the depth of a tree is that of its parentheses.
    """

    first: Node
    rest: tuple[Operand, ...]


@dataclass(frozen=True)
class Call(Node):
    """A function of its arguments."""

    function: str
    arguments: tuple[Node, ...]


class ArithmeticParser:
    """Recursive descent over one text from an offset on, one method per rule; each raises an ExpressionError."""

    SYMBOLS: ClassVar[tuple[str, ...]] = ("+", "-", "*", "/", "(", ")", "%")
    OPERAND: ClassVar[str] = "a number"  # what may stand between operators, for error messages
    INFINITY: ClassVar[str] = ""  # how infinity is written, for error messages; empty where numbers are finite
    MAX_DEPTH: ClassVar[int] = 50  # depth of parentheses; it is limited before Python's stack is
    MAX_TOKENS: ClassVar[int] = 1000

    def __init__(self, text: str, start: int = 0) -> None:
        self.tokens = Tokens(text, self.SYMBOLS, start)
        self.depth = 0

    @property
    def token(self) -> Token:
        """The current token."""
        return self.tokens.current

    def sum(self) -> Node:
        """Read ``sum = product {("+" | "-") product}``."""
        first, rest = self.product(), []
        while sign := self.tokens.accept("+", "-"):
            rest.append(Operand(sign.text, self.product(), column=sign.column))
        return Operation(first, tuple(rest), column=rest[0].column) if rest else first

    def product(self) -> Node:
        """Read ``product = signed {("*" | "/") signed}``."""
        first, rest = self.signed(), []
        while sign := self.tokens.accept("*", "/"):
            if sign.text == self.token.text == "*":
                raise ExpressionError(sign.column, "there is no '**'; a power is written x*x")
            rest.append(Operand(sign.text, self.signed(), column=sign.column))
        return Operation(first, tuple(rest), column=rest[0].column) if rest else first

    def signed(self) -> Node:
        """Read ``signed = {"+" | "-"} atom ["%"]``."""
        n_minus, column = 0, self.token.column
        while sign := self.tokens.accept("+", "-"):
            n_minus += sign.text == "-"
        node = self.atom()
        if percent := self.tokens.accept("%"):
            node = Percent(node, column=percent.column)
        return Negation(node, column=column) if n_minus % 2 else node

    def atom(self) -> Node:
        """Read ``atom = number | named | "(" sum ")"``."""
        if self.tokens.n_read > self.MAX_TOKENS:
            raise ExpressionError(self.token.column, f"longer than {self.MAX_TOKENS} numbers, names and symbols")
        token = self.token
        if token.text == "(":
            return self.group()
        if token.kind == "name":
            return self.named(self.tokens.next())
        if token.kind != "number":
            raise self.unexpected(self.OPERAND)
        value = float(self.tokens.next().text)
        if math.isinf(value):
            hint = f"; infinity is written {self.INFINITY}" if self.INFINITY else ""
            raise ExpressionError(token.column, f"the number {token.text} is too large{hint}")
        return Number(value, column=token.column)

    def named(self, token: Token) -> Node:
        """Read what begins with a name, which is the token passed last."""
        raise NotImplementedError

    def group(self) -> Node:
        """Read ``group = "(" sum ")"``."""
        opening = self.open()
        node = self.sum()
        self.close(opening, ")")
        return node

    def open(self) -> Token:
        """Move past an opening bracket, whose closing one `close` will look for."""
        opening = self.tokens.next()
        self.depth += 1
        if self.depth > self.MAX_DEPTH:
            raise ExpressionError(opening.column, f"nested deeper than {self.MAX_DEPTH} levels")
        return opening

    def close(self, opening: Token, closing: str) -> None:
        """Move past a closing bracket."""
        if self.token.kind == "end":
            raise ExpressionError(opening.column, f"{opening.text!r} is not closed")
        if not self.tokens.accept(closing):
            raise self.unexpected(repr(closing))
        self.depth -= 1

    def finish(self) -> None:
        """Check that the text ends here."""
        if self.token.kind != "end":
            raise self.unexpected("the end")

    def unexpected(self, expected: str) -> ExpressionError:
        """Return an error that explains why the current token is not allowed here."""
        token, before = self.token, self.tokens.previous
        if token.kind == "end":
            return ExpressionError(token.column, f"expected {expected} (got the end)")
        complete = before.kind in ("number", "name") or before.text in (")", "%", "]")
        if before.kind == "number" and token.kind == "name" and token.text.startswith("_"):
            return ExpressionError(token.column, f"digits are not grouped with '_' ({before.text}{token.text})")
        if complete and (token.kind in ("number", "name") or token.text == "("):
            follows = {"name": token.text, "symbol": "(...)"}.get(token.kind, "")
            plausible = before.kind in ("number", "name") and (token.text == "(" or self.is_known(token.text))
            hint = f"; did you mean {before.text}*{follows}?" if plausible else ""
            return ExpressionError(token.column, f"an operator is missing before {token.text!r}{hint}")
        return ExpressionError(token.column, f"expected {expected} (got {token.text!r})")

    def is_known(self, name: str) -> bool:
        """Whether a name may begin an operand."""
        return False


def unknown_name(token: Token, kind: str, known: Collection[str]) -> ExpressionError:
    """Return an error that names what is known and what is near; the kind is a word such as "name" or "function"."""
    near = get_close_matches(token.text, known, n=3)
    # Of equally near names the last one, which is the user's.
    near.sort(key=lambda each: (SequenceMatcher(None, each, token.text).ratio(), [*known].index(each)))
    hint = f"; did you mean {near[-1]!r}?" if near else ""
    return ExpressionError(token.column, f"unknown {kind} {token.text!r} (known: {', '.join(known)}){hint}")
