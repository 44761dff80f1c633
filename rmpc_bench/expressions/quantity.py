"""Quantities in configurations: ``2*pi``, ``10%``, ``1 + eps_min``, ``+-10%``; read by `arithmetic`, never by ``eval``.

named = "pi" | free name | ("sqrt" | "sin" | "cos" | "exp" | "log") "(" sum ")"
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NoReturn, TypeAlias

import numpy as np

from rmpc_bench.expressions.arithmetic import (
    ArithmeticParser,
    Call,
    Name,
    Negation,
    Node,
    Number,
    Operation,
    Percent,
    unknown_name,
)
from rmpc_bench.expressions.tokens import ExpressionError, Token

MAX_LENGTH = 1000
Column: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]
"""Numbers of many rows, (n,)."""
_CONSTANTS = {"pi": math.pi}
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "exp": math.exp,
    "log": math.log,
}
RESERVED = (*_CONSTANTS, *_FUNCTIONS)
"""Names that have a meaning in every quantity."""
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
_UNIT = re.compile(r"[^\W\d_][\w/^*.· -]*")
_FILE = re.compile(r"[^*()]+\.(mat|npz|csv|npy|txt)", re.IGNORECASE)
_SPREAD = re.compile(r"\s*(?:\+\s*-|±)")


_REFUSED: ContextVar[Mapping[str, str]] = ContextVar("_REFUSED", default=MappingProxyType({}))
"""Names of `refusing`; validators of pydantic, which read most quantities, take no further argument."""


@contextmanager
def refusing(names: Mapping[str, str]) -> Iterator[None]:
    """Say of names that stand for no number here why they cannot be used: name -> the words of the error."""
    token = _REFUSED.set(names)
    try:
        yield
    finally:
        _REFUSED.reset(token)


class QuantityError(ValueError):
    """A text that is no quantity, or a quantity that has no finite value."""


@dataclass(frozen=True)
class Expression:
    """Arithmetic with free names; call it with their values."""

    text: str  # as written
    names: frozenset[str]  # free names that it uses
    tree: Node = field(repr=False)  # what the text means

    @property
    def canonical(self) -> str:
        """Postfix text: equal for texts that differ in blanks, needless signs and needless parentheses only."""
        return " ".join(_postfix(self.tree))

    def __call__(self, values: Mapping[str, float] = {}) -> float:
        """Evaluate in plain float arithmetic; the values have at least the ``names``, and the result is finite.

        Raises a QuantityError when there is no number, with the column of the operation that fails.
        """
        try:
            return _value(self.tree, values)
        except ExpressionError as error:
            _fail(self.text, error)

    def of_columns(self, columns: Mapping[str, Column], n: int) -> Column | None:
        """Evaluate n rows at once, each as a call does; None where one is not finite, or beyond plain arithmetic.

        Columns are (n,) numbers for every name in ``names``, and so is the result.
        """
        return _column(self.tree, columns, n)


def _column(node: Node, columns: Mapping[str, Column], n: int) -> Column | None:
    """Evaluate a node for many rows; None where a value is not finite, or where it calls a function."""
    found: Column | None = None
    if isinstance(node, Number):
        found = np.full(n, float(node.value))
    elif isinstance(node, Name):
        found = columns.get(node.name)
    elif isinstance(node, Negation | Percent):
        operand = _column(node.operand, columns, n)
        if operand is not None:
            found = -operand if isinstance(node, Negation) else operand / 100
    elif isinstance(node, Operation):
        found = _column(node.first, columns, n)
        for following in node.rest:
            right = _column(following.node, columns, n)
            if found is None or right is None:
                return None
            with np.errstate(all="ignore"):
                found = _OPERATORS[following.operator](found, right)
            if not np.isfinite(found).all():
                return None
    return found if found is not None and np.isfinite(found).all() else None


def _value(node: Node, values: Mapping[str, float]) -> float:
    """Evaluate a node, operations from left to right; every intermediate number must be finite."""
    match node:
        case Number():
            return node.value
        case Name():
            if node.name not in values:
                raise ExpressionError(node.column, f"no value is given for {node.name!r}")
            return _finite(float(values[node.name]), node.column)
        case Negation():
            return -_value(node.operand, values)
        case Percent():
            return _value(node.operand, values) / 100
        case Call():
            argument = _value(node.arguments[0], values)
            if node.function == "sqrt" and argument < 0:
                raise ExpressionError(node.column, f"sqrt of a negative number ({argument!r})")
            if node.function == "log" and argument <= 0:
                raise ExpressionError(node.column, f"log of a number that is not positive ({argument!r})")
            try:
                return _finite(_FUNCTIONS[node.function](argument), node.column)
            except OverflowError:
                raise ExpressionError(node.column, f"{node.function}({argument!r}) is too large") from None
        case Operation():
            result = _value(node.first, values)
            for operand in node.rest:
                right = _value(operand.node, values)
                if operand.operator == "/" and right == 0:
                    raise ExpressionError(operand.column, "division by zero")
                result = _finite(_OPERATORS[operand.operator](result, right), operand.column)
            return result
    raise TypeError(f"{type(node).__name__} is no part of a quantity")


def _finite(value: float, column: int) -> float:
    if not math.isfinite(value):
        raise ExpressionError(column, f"the value is not finite ({value})")
    return value


def _postfix(node: Node) -> Iterator[str]:
    match node:
        case Number():
            yield str(node.value)
        case Name():
            yield node.name
        case Negation():
            yield from (*_postfix(node.operand), "neg")
        case Percent():
            yield from (*_postfix(node.operand), "%")
        case Call():
            yield from (*_postfix(node.arguments[0]), node.function)
        case Operation():
            yield from _postfix(node.first)
            for operand in node.rest:
                yield from (*_postfix(operand.node), operand.operator)


def _fail(text: str, error: ExpressionError) -> NoReturn:
    quoted = text if len(text) <= 80 else text[:77] + "..."
    raise QuantityError(f"column {error.column} of {quoted!r}: {error.message}") from None


class _QuantityParser(ArithmeticParser):
    """Arithmetic with constants, functions of one number, and free names."""

    def __init__(self, text: str, names: Collection[str], start: int) -> None:
        self.free, self.used = names, set[str]()
        super().__init__(text, start)

    def parse(self) -> Expression:
        tree = self.sum()
        self.finish()
        return Expression(self.tokens.text, frozenset(self.used), tree)

    def named(self, token: Token) -> Node:
        """Read ``named = constant | free name | function "(" sum ")"``."""
        if token.text in _FUNCTIONS:
            if self.token.text != "(":
                raise ExpressionError(token.column, f"{token.text!r} needs parentheses: {token.text}(...)")
            return Call(token.text, (self.group(),), column=token.column)
        if token.text in _CONSTANTS:
            return Number(_CONSTANTS[token.text], column=token.column)
        if token.text in self.free:
            self.used.add(token.text)
            return Name(token.text, column=token.column)
        if token.text.lower() in ("nan", "inf", "infinity"):
            raise ExpressionError(token.column, f"{token.text!r} is not a number; numbers here are finite")
        if refused := _REFUSED.get().get(token.text):
            raise ExpressionError(token.column, refused)
        raise unknown_name(token, "name", [*_CONSTANTS, *_FUNCTIONS, *sorted(self.free)])

    def is_known(self, name: str) -> bool:
        """Whether a name may begin an operand."""
        return name in RESERVED or name in self.free


def parse(text: str | float | int, names: Collection[str] = ()) -> Expression:
    """Read a quantity with some free names; ``pi`` and the functions cannot be among them.

    Raises a QuantityError with what is wrong, and its column.
    """
    return _parse(text, names, 0)


def _parse(text: str | float | int, names: Collection[str], start: int) -> Expression:
    if isinstance(text, bool) or not isinstance(text, str | float | int):
        raise QuantityError(f"expected a number or arithmetic such as '2*pi' (got {text!r})")
    taken = [name for name in names if name in RESERVED]
    if taken:
        raise QuantityError(f"{taken[0]!r} already has a meaning in quantities; it cannot be a free name")
    if not isinstance(text, str):
        text = _number_text(text)
    if len(text) > MAX_LENGTH:
        raise QuantityError(f"a quantity has at most {MAX_LENGTH} characters (got {len(text)})")
    try:
        return _QuantityParser(text, names, start).parse()
    except ExpressionError as error:
        if file := written_file(text):
            raise QuantityError(f"a file is written {file}") from None
        _fail(text, error)


def written_file(text: str) -> str:
    """Write how a configuration names a file of numbers; empty where a text is no name of one."""
    found = _FILE.fullmatch(text)
    ending = found[1].lower() if found else ""
    name, other = ", name: A" * (ending != "csv"), ", and ends in .mat, .npz or .csv" * (ending in ("npy", "txt"))
    return f"{{file: {text}{name}}}{other}" if found else ""


def _number_text(number: float | int) -> str:
    """Write a finite number so that reading it gives the same bits."""
    try:
        value = float(number)
    except OverflowError:
        raise QuantityError("the number is too large") from None
    if not math.isfinite(value):
        raise QuantityError(f"{value} is not a quantity; numbers here are finite")
    return float.__repr__(value) if isinstance(number, float) else int.__repr__(number)


def number(value: str | float | int) -> float:
    """Read and evaluate a quantity without free names; raises QuantityError as `parse` does."""
    return parse(value)()


def with_unit(value: str | float | int) -> tuple[float, str]:
    """Read a quantity that may have a unit behind it, after a blank: ``8 ml/s``.

    Units are names here, empty where none is given; nothing is converted.  Raises a QuantityError when there is no
    number.

    Examples
    --------
    >>> with_unit("8 ml/s"), with_unit("2*pi rad"), with_unit(0.5)
    ((8.0, 'ml/s'), (6.283185307179586, 'rad'), (0.5, ''))
    """
    try:
        return number(value), ""
    except QuantityError:
        if not isinstance(value, str):
            raise
        words = value.split()
        for n in range(len(words) - 1, 0, -1):
            unit = " ".join(words[n:])
            if not _UNIT.fullmatch(unit):
                continue
            try:
                return number(" ".join(words[:n])), unit
            except QuantityError:
                continue
        raise


def spread(text: str | float | int) -> float | None:
    """Half the width that ``+-10%`` or ``±10%`` states (here 0.1); None when the text does not start with the sign.

    Raises a QuantityError when what follows the sign is no quantity, or is negative.
    """
    sign = _SPREAD.match(text) if isinstance(text, str) else None
    if sign is None:
        return None
    width = _parse(text, (), sign.end())()
    if width < 0:
        raise QuantityError(f"a spread must be >= 0 (got {width!r} in {text!r})")
    return abs(width)
