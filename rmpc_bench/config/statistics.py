"""The section `statistics`: which comparisons are made, and what counts in them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Lt

from rmpc_bench.expressions.arithmetic import ArithmeticParser, Call, Name, Node, unknown_name
from rmpc_bench.expressions.quantity import RESERVED, QuantityError, number
from rmpc_bench.expressions.tokens import ExpressionError, Token
from rmpc_bench.types import NonNegative
from rmpc_bench.types.basics import Text
from rmpc_bench.types.metric import OPERATORS, ComparisonKeys, Limit, Requirement

DEFAULT_RELEVANT = 0.01
Relevant: Any = Annotated[float, Ge(0), Lt(1)] | dict[str, NonNegative]


BEST_AT = {"zero": 0, "one": 1}  # direction of a metric that has its best value inside of its range -> this value
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_ONCE = "names one metric, once, between comparisons with numbers"


@dataclass(frozen=True)
class Statistics(ComparisonKeys):
    """Comparison of the methods; docs/statistics.md explains the numbers.

    A signed metric, for which 0 is best or which has negative values, takes a margin in its unit; without one, none of
    its differences is too small to matter.

    Parameters
    ----------
    primary : metric that has the verdicts; the first one if not given
    baseline : method with which the others are compared; the first one if not given
    confidence : level of all intervals, such as 95%
    relevant : smallest difference that matters: a relative change for all metrics, or a number per metric
    average : averages of the paired runs, the geometric mean of their ratios or the ratio of the means
    requirement : condition on a metric of a run, such as settling_time < 20, or a list of conditions; the share of runs
        that meet it is computed
    """

    primary: Text | None = None
    baseline: Text | None = None
    confidence: Annotated[float, Gt(0), Lt(1)] = 0.95
    relevant: Relevant = DEFAULT_RELEVANT
    average: Literal["geometric", "mean", "both"] = "both"
    requirement: Text | list[Text] = field(default_factory=list)

    @property
    def requirements(self) -> list[str]:
        """The requirements as a list."""
        return [self.requirement] if isinstance(self.requirement, str) else self.requirement

    @property
    def relevant_change(self) -> float:
        """The smallest relative change that matters in a metric without a margin of its own."""
        return DEFAULT_RELEVANT if isinstance(self.relevant, dict) else self.relevant

    @property
    def margins(self) -> dict[str, float]:
        """Metric -> margin of its own."""
        return self.relevant if isinstance(self.relevant, dict) else {}


def read_requirement(text: str, metrics: Collection[str]) -> Requirement:
    """Read a requirement such as ``settling_time < 20``; an ExpressionError has column and nearest known metric."""
    return _Parser(text, metrics).requirement()


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
        if token.text in RESERVED:
            return Call(token.text, (self.group(),) if self.token.text == "(" else (), column=token.column)
        raise unknown_name(token, "metric", sorted(self.metrics))

    def is_known(self, name: str) -> bool:
        """Whether a name may begin an operand."""
        return name in self.metrics
