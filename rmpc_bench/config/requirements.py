"""Reads requirements on the metric of a run, such as ``settling_time < 20`` or ``abs(steady_state_error) < 0.05``.

    requirement = side link {link}
    link        = ("<" | "<=" | ">" | ">=") side
    side        = sum of numbers | METRIC | "abs" "(" METRIC ")"

Numbers are those of claims: ``pi``, ``5%``, arithmetic.  A chain has the metric once, as in ``-1 < m < 1``.
"""

from __future__ import annotations

from collections.abc import Collection

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.expressions.arithmetic import ArithmeticParser, Call, Name, Node, unknown_name
from rmpc_bench.expressions.quantity import QuantityError, number
from rmpc_bench.expressions.tokens import ExpressionError, Token
from rmpc_bench.types.requirement import OPERATORS, Limit, Requirement

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_ONCE = "names one metric, once, between comparisons with numbers"


def check_requirements(draft: DraftConfig) -> None:
    """Add an error for every requirement that is none, or that names no metric of the configuration."""
    statistics = draft.values["statistics"]
    for place, text in enumerate(statistics.requirements if statistics is not None else ()):
        path: list[str | int] = ["statistics", "requirement"]
        path += [] if isinstance(statistics.requirement, str) else [place]
        try:
            read_requirement(text, draft.metric_names)
        except ExpressionError as error:
            draft.note(path, f"column {error.column} of {text!r}: {error.message}")


def read_requirement(text: str, metrics: Collection[str]) -> Requirement:
    """Read a requirement such as ``settling_time < 20`` of known metrics.

    Raises an ExpressionError with the column, and for an unknown metric the nearest one.
    """
    parser = _Parser(text, metrics)
    return parser.requirement()


class _Parser(ArithmeticParser):
    """Numbers and one metric, with comparisons between them."""

    SYMBOLS = (*ArithmeticParser.SYMBOLS, *OPERATORS)
    OPERAND = "a number or the name of a metric"

    def __init__(self, text: str, metrics: Collection[str]) -> None:
        self.metrics = metrics
        super().__init__(text)

    def requirement(self) -> Requirement:
        """Read ``requirement = side link {link}``."""
        text, sides, signs = self.tokens.text, [self._side()], []
        while sign := self.tokens.accept(*OPERATORS):
            signs.append(sign)
            sides.append(self._side())
        if not signs:
            raise self.unexpected(f"a comparison ({', '.join(OPERATORS)})")
        self.finish()
        places = [place for place, side in enumerate(sides) if isinstance(side, Name)]
        if len(places) != 1 or len(sides) - 1 > 2 or (len(signs) == 2 and places[0] != 1):
            raise ExpressionError(signs[0].column, f"a requirement {_ONCE}")
        metric = sides[places[0]]
        assert isinstance(metric, Name)
        limits = []
        for place, sign in enumerate(signs):
            left = place == places[0]
            value = sides[place + 1] if left else sides[place]
            assert isinstance(value, float)
            limits.append(Limit(sign.text if left else _MIRRORED[sign.text], value))
        absolute, name = metric.name.startswith("|"), metric.name.strip("|")
        return Requirement(text, name, tuple(limits), absolute)

    def _side(self) -> Name | float:
        """Read a metric or a number; arithmetic with a metric is none of both."""
        start, column = self.token.start, self.token.column
        node = self.sum()
        if isinstance(node, Name):
            return node
        try:
            return number(self.tokens.since(start))
        except QuantityError:
            raise ExpressionError(column, f"a requirement {_ONCE}; there is no arithmetic with a metric") from None

    def named(self, token: Token) -> Node:
        """Read a metric, ``abs(METRIC)``, or a name of the numbers."""
        if token.text == "abs" and self.token.text == "(":
            opening = self.open()
            inner = self.sum()
            self.close(opening, ")")
            if not isinstance(inner, Name):
                raise ExpressionError(token.column, "abs takes the name of a metric")
            return Name(f"|{inner.name}|", column=token.column)
        if token.text in self.metrics:
            return Name(token.text, column=token.column)
        if token.text in ("pi", "sqrt", "sin", "cos"):
            return Call(token.text, (self.group(),) if self.token.text == "(" else (), column=token.column)
        raise unknown_name(token, "metric", sorted(self.metrics))

    def is_known(self, name: str) -> bool:
        """Whether a name may begin an operand."""
        return name in self.metrics
