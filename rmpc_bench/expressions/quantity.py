"""Arithmetic in configurations: ``2*pi``, ``10%``, ``1 + eps_min``; an own small grammar, never ``eval``.

    sum     = product {("+" | "-") product}
    product = signed {("*" | "/") signed}
    signed  = {"+" | "-"} atom ["%"]
    atom    = number | "pi" | name | ("sqrt" | "sin" | "cos") "(" sum ")" | "(" sum ")"

A text becomes a flat postfix program, so that evaluating, hashing and pickling need no recursion.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import NamedTuple, NoReturn

MAX_LENGTH = 1000
MAX_DEPTH = 50
_CONSTANTS = {"pi": math.pi}
_FUNCTIONS: dict[str, Callable[[float], float]] = {"sqrt": math.sqrt, "sin": math.sin, "cos": math.cos}
_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)|(?P<name>[^\W\d]\w*)"
    r"|(?P<sign>[-+*/()%])|(?P<end>$))"
)
_SPREAD = re.compile(r"\s*(?:\+\s*-|±)")


class QuantityError(ValueError):
    """A text that is no quantity, or a quantity that has no finite value."""


def _explain(text: str, column: int, message: str) -> str:
    shown = text if len(text) <= 80 else text[:77] + "..."
    return f"column {column} of {shown!r}: {message}"


class _Token(NamedTuple):
    kind: str
    text: str
    column: int
    end: int


class _Step(NamedTuple):
    """Push a number or a name, or apply ``neg``, ``%``, a function or an operator to the stack."""

    kind: str
    argument: float | str
    column: int


@dataclass(frozen=True)
class Expression:
    """Arithmetic with free names; call it with their values."""

    text: str
    names: frozenset[str]
    program: tuple[_Step, ...] = field(repr=False)

    @property
    def canonical(self) -> str:
        """The program as postfix text: equal for texts that differ in blanks and needless parentheses only."""
        return " ".join(str(step.argument) if step.argument != "" else step.kind for step in self.program)

    def __call__(self, values: Mapping[str, float] = {}) -> float:
        """Evaluate in plain float arithmetic.

        Parameters
        ----------
        values : a number for every name in ``names``; more are ignored

        Returns
        -------
        A finite number; QuantityError when there is none.
        """
        stack: list[float] = []
        for step in self.program:
            result = self._apply(step, stack, values)
            if not math.isfinite(result):
                self._fail(step, f"the value is not finite ({result})")
            stack.append(result)
        return stack[0]

    def _apply(self, step: _Step, stack: list[float], values: Mapping[str, float]) -> float:
        kind, argument, _ = step
        if kind == "number":
            return float(argument)
        if kind == "name":
            if argument not in values:
                self._fail(step, f"no value is given for {argument!r}")
            return float(values[str(argument)])
        last = stack.pop()
        if kind == "neg":
            return -last
        if kind == "%":
            return last / 100
        if kind == "function":
            if argument == "sqrt" and last < 0:
                self._fail(step, f"sqrt of a negative number ({last!r})")
            return _FUNCTIONS[str(argument)](last)
        if argument == "/" and last == 0:
            self._fail(step, "division by zero")
        return _OPERATORS[str(argument)](stack.pop(), last)

    def _fail(self, step: _Step, message: str) -> NoReturn:
        raise QuantityError(_explain(self.text, step.column, message))


class _Parser:
    """Recursive descent over one text; depth is limited before Python's stack is."""

    def __init__(self, text: str, names: Collection[str], start: int) -> None:
        if len(text) > MAX_LENGTH:
            raise QuantityError(f"a quantity has at most {MAX_LENGTH} characters (got {len(text)})")
        self.text, self.names, self.depth = text, names, 0
        self.program: list[_Step] = []
        self.token = self.previous = _Token("start", "", start + 1, start)
        self.next()

    def parse(self) -> Expression:
        self.sum()
        if self.token.kind != "end":
            self.unexpected()
        names = frozenset(str(step.argument) for step in self.program if step.kind == "name")
        return Expression(self.text, names, tuple(self.program))

    def next(self) -> _Token:
        """Move on by one token and return the one passed."""
        self.previous, start = self.token, self.token.end
        match = _TOKEN.match(self.text, start)
        if match is None or match.lastgroup is None:
            column = start + len(self.text[start:]) - len(self.text[start:].lstrip()) + 1
            character = self.text[column - 1]
            if self.text[column - 1 :].lower().startswith((".inf", ".nan")):
                self.fail(f"{self.text[column - 1 : column + 3]!r} is not a quantity; numbers here are finite", column)
            hint = {",": "; decimals are written with a point", "^": "; a power is written x*x"}.get(character, "")
            self.fail(f"{character!r} is not part of a quantity{hint}", column)
        kind = match.lastgroup
        self.token = _Token(kind, match[kind], match.start(kind) + 1, match.end())
        return self.previous

    def fail(self, message: str, column: int) -> NoReturn:
        raise QuantityError(_explain(self.text, column, message))

    def emit(self, kind: str, argument: float | str, column: int) -> None:
        self.program.append(_Step(kind, argument, column))

    def sum(self) -> None:
        self.product()
        while self.token.text in ("+", "-"):
            sign = self.next()
            self.product()
            self.emit("operator", sign.text, sign.column)

    def product(self) -> None:
        self.signed()
        while self.token.text in ("*", "/"):
            sign = self.next()
            if sign.text == self.token.text == "*":
                self.fail("there is no '**'; a power is written x*x", sign.column)
            self.signed()
            self.emit("operator", sign.text, sign.column)

    def signed(self) -> None:
        minuses = []
        while self.token.text in ("+", "-"):
            sign = self.next()
            minuses += [sign.column] if sign.text == "-" else []
        self.atom()
        if self.token.text == "%":
            self.emit("%", "", self.next().column)
        for column in reversed(minuses):
            self.emit("neg", "", column)

    def atom(self) -> None:
        token = self.token
        if token.kind == "number":
            if not math.isfinite(float(token.text)):
                self.fail(f"the number {token.text} is too large", token.column)
            self.emit("number", float(self.next().text), token.column)
        elif token.text == "(":
            self.group()
        elif token.kind == "name":
            self.name(self.next())
        else:
            self.unexpected()

    def group(self) -> None:
        opening = self.next()
        self.depth += 1
        if self.depth > MAX_DEPTH:
            self.fail(f"parentheses are nested deeper than {MAX_DEPTH} levels", opening.column)
        self.sum()
        if self.token.kind == "end":
            self.fail("'(' is never closed", opening.column)
        if self.token.text != ")":
            self.unexpected()
        self.next()
        self.depth -= 1

    def name(self, token: _Token) -> None:
        if token.text in _FUNCTIONS:
            if self.token.text != "(":
                self.fail(f"{token.text!r} needs parentheses: {token.text}(...)", token.column)
            self.group()
            self.emit("function", token.text, token.column)
        elif token.text in _CONSTANTS:
            self.emit("number", _CONSTANTS[token.text], token.column)
        elif token.text in self.names:
            self.emit("name", token.text, token.column)
        elif token.text.lower() in ("nan", "inf", "infinity"):
            self.fail(f"{token.text!r} is not a quantity; numbers here are finite", token.column)
        else:
            known = [*_CONSTANTS, *_FUNCTIONS, *sorted(self.names)]
            near = get_close_matches(token.text, known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            self.fail(f"unknown name {token.text!r} (known: {', '.join(known)}){hint}", token.column)

    def unexpected(self) -> NoReturn:
        """Say why the current token cannot stand where it does."""
        token, before = self.token, self.previous
        if token.kind == "end":
            self.fail("a number is missing at the end" if before.text else "a number is missing", token.column)
        complete = before.kind in ("number", "name") or before.text in (")", "%")
        if before.kind == "number" and token.kind == "name" and token.text.startswith("_"):
            self.fail(f"digits are not grouped with '_' ({before.text}{token.text})", token.column)
        if complete and (token.kind in ("number", "name") or token.text == "("):
            follows = {"name": token.text, "sign": "(...)"}.get(token.kind, "")
            known = token.text in _CONSTANTS or token.text in _FUNCTIONS or token.text in self.names
            plausible = before.text not in (")", "%") and (known or token.text == "(")
            hint = f"; did you mean {before.text}*{follows}?" if plausible else ""
            self.fail(f"an operator is missing before {token.text!r}{hint}", token.column)
        self.fail(f"unexpected {token.text!r}", token.column)


def parse(text: str | float | int, names: Collection[str] = ()) -> Expression:
    """Read a quantity.

    Parameters
    ----------
    text : the arithmetic, or a number
    names : free names that it may use; ``pi`` and the functions cannot be among them

    Returns
    -------
    What to call for the value; QuantityError says what is wrong and at which column.
    """
    return _parse(text, names, 0)


def _parse(text: str | float | int, names: Collection[str], start: int) -> Expression:
    if isinstance(text, bool) or not isinstance(text, str | float | int):
        raise QuantityError(f"expected a number or arithmetic such as '2*pi' (got {text!r})")
    taken = [name for name in names if name in _CONSTANTS or name in _FUNCTIONS]
    if taken:
        raise QuantityError(f"{taken[0]!r} already has a meaning in quantities; it cannot be a free name")
    if not isinstance(text, str):
        try:
            value = float(text)
        except OverflowError:
            raise QuantityError("the number is too large") from None
        if not math.isfinite(value):
            raise QuantityError(f"{value} is not a quantity; numbers here are finite")
        text = float.__repr__(value) if isinstance(text, float) else int.__repr__(text)
    return _Parser(text, names, start).parse()


def number(value: str | float | int) -> float:
    """Read and evaluate a quantity without free names."""
    return parse(value)()


def spread(text: str | float | int) -> float | None:
    """Half the width that ``+-10%`` or ``±10%`` states (here 0.1); None when the text does not start so."""
    sign = _SPREAD.match(text) if isinstance(text, str) else None
    if sign is None:
        return None
    width = _parse(text, (), sign.end())()
    if width < 0:
        raise QuantityError(f"a spread must be >= 0 (got {width!r} in {text!r})")
    return abs(width)
