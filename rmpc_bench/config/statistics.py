"""The sections `statistics` and `calibration`: which comparisons are made, and what counts in them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Len, Lt

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.identity import SweepPoint, independent_laws
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map, Mark, locate
from rmpc_bench.expressions.arithmetic import ArithmeticParser, Call, Name, Node, unknown_name
from rmpc_bench.expressions.quantity import RESERVED, QuantityError, number
from rmpc_bench.expressions.tokens import ExpressionError, Token
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import NonNegative
from rmpc_bench.types.errors import nearest
from rmpc_bench.types.metric import OPERATORS, AdjustKeys, CalibrationKeys, ComparisonKeys, Limit, Requirement

Text = Annotated[str, Len(1)]
DEFAULT_RELEVANT = 0.01
Relevant: Any = Annotated[float, Ge(0), Lt(1)] | dict[str, NonNegative]


BEST_AT = {"zero": 0, "one": 1}  # direction of a metric that has its best value inside of its range -> this value
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_METRIC = "metric of this configuration"
_NO_LAW = "has no independent law that is known"
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

    def check(self, draft: DraftConfig, point: SweepPoint | None) -> None:
        """Refuse requirements that are none, and ranks and lost runs by a metric that does not fit."""
        for place, text in enumerate(self.requirements):
            try:
                read_requirement(text, draft.metric_names)
            except ExpressionError as error:
                path: list[str | int] = ["statistics", "requirement"]
                path += [] if isinstance(self.requirement, str) else [place]
                draft.note(path, f"column {error.column} of {text!r}: {error.message}")
        if self.two_way is not None and len(self.two_way) != 2:
            draft.note(["statistics", "two_way"], f"must name two axes (got {len(self.two_way)})")
        for part, (axis, entries) in zip((0, 2), (self.two_way or {}).items(), strict=False):
            known = dict.fromkeys(name.partition("+")[part] for name in draft.values["methods"] or {} if "+" in name)
            for place, name in enumerate(entries):
                at: list[str | int] = ["statistics", "two_way", axis, place]
                if name not in known and not draft.is_inherited(at):
                    draft.note(at, unknown(name, known, f"{axis} in the names of methods"))
        if point is not None:
            _check_adjust(draft, point.experiment)
        infos = () if point is None else point.experiment.metric_infos
        info = next((each for each in infos if each.name == (self.primary or infos[0].name)), None)
        if info is None:
            return
        if self.ranks and (info.may_not_occur or info.direction == "zero"):
            why = "may not occur in a run" if info.may_not_occur else "is best at 0, so that ratios mean nothing"
            draft.note(["statistics", "ranks"], f"{info.name} {why}; choose another metric with statistics.primary")
        if self.lost is not None and info.direction != "lower":
            why = "a larger one is better" if info.direction == "higher" else f"it is best at {BEST_AT[info.direction]}"
            message = f"a run is lost where {info.name} is large, but {why}"
            draft.note(["statistics", "lost"], f"{message}; choose another metric with statistics.primary")


def _check_adjust(draft: DraftConfig, experiment: Experiment) -> None:
    """Refuse quantities that averages cannot be adjusted for; inherited ones that do not exist are left out."""
    adjust, path = draft.values["statistics"].adjust, list[str | int](["statistics", "adjust"])
    path += ["for"] if isinstance(adjust, AdjustKeys) else []
    names = adjust.for_ if isinstance(adjust, AdjustKeys) else [] if isinstance(adjust, str) else adjust
    laws, gone = independent_laws(experiment), list[str]()
    known = dict.fromkeys([*experiment.scenario.quantities, *laws])
    if names == [] and not isinstance(adjust, str):
        draft.note(path, "must name at least one quantity; `none` adjusts for nothing")
    for place, name in enumerate(names or ()):
        dist = laws.get(name, {}).get("dist", "")
        if name in (names or ())[:place]:
            draft.note([*path, place], f"names {name!r} twice; name each once")
        elif dist in ("uniform", "choice", "normal", "fixed"):
            continue
        elif name in known or name in experiment.scenario.burst_names:
            why = f"has a {dist} law, for which there are no polynomials" if dist else _NO_LAW
            draft.note([*path, place], f"{name} {why}")
        elif draft.is_inherited([*path, place]):
            gone.append(name)
            draft.left_out.append(f"statistics.adjust: {name} does not exist here")
        else:
            near = nearest(name, [*known])
            others = f"known: {', '.join(known)}" if known else "give its law in `uncertainty`"
            hint = f"did you mean {near!r}?" if near else others
            draft.note([*path, place], f"{name!r} is not an uncertain quantity; {hint}")
    if gone:
        kept = [name for name in names or () if name not in gone]
        changed = replace(adjust, for_=kept) if isinstance(adjust, AdjustKeys) else kept
        draft.values["statistics"] = replace(draft.values["statistics"], adjust=changed)


def check_statistics(draft: DraftConfig, point: SweepPoint | None) -> None:
    """Check the section of the first draft; its names are read from the tree, whether or not its values are valid."""
    given = draft.tree.get("statistics")
    if isinstance(given, Map):
        _check_names(draft, given)
    if draft.values["statistics"] is not None:
        draft.values["statistics"].check(draft, point)


def _check_names(draft: DraftConfig, given: Map) -> None:
    """Refuse a primary metric, a baseline and margins that do not exist; of inherited ones the defaults are used."""
    metrics, dropped = draft.metric_names, dict[str, Any]()
    for key, known, noun in (("primary", metrics, _METRIC), ("baseline", [*draft.methods], "method")):
        name = given.get(key)
        if not isinstance(name, str) or name in known:
            continue
        if not draft.is_inherited(["statistics", key]):
            if known or key == "primary":
                draft.note(["statistics", key], unknown(name, known, noun))
        elif known:
            dropped[key] = None
            draft.left_out.append(f"statistics.{key}: {name} does not exist here; it is {known[0]} instead")
    margins, gone = given.get("relevant"), list[str]()
    for name in margins if isinstance(margins, Map) else ():
        if name not in metrics:
            if draft.is_inherited(["statistics", "relevant", name]):
                gone.append(name)
                draft.left_out.append(f"statistics.relevant.{name}: there is no such metric here")
            else:
                draft.note(["statistics", "relevant", name], unknown(name, metrics, _METRIC))
    statistics = draft.values["statistics"]
    if statistics is not None:
        if gone:
            dropped["relevant"] = {name: value for name, value in statistics.relevant.items() if name not in gone}
        draft.values["statistics"] = replace(statistics, **dropped)


def read_calibration(draft: DraftConfig) -> None:
    """Replace `calibration: true` by its defaults and `false` by None; the level of the verdict is one of those."""
    keys = draft.values["calibration"]
    draft.values["calibration"] = keys = CalibrationKeys() if keys is True else keys or None
    if keys is None:
        return
    levels = ", ".join(f"{100 * level:g}%" for level in keys.levels)
    if keys.verdict not in keys.levels:
        draft.note(["calibration", "verdict"], f"{100 * keys.verdict:g}% is not among levels [{levels}]")
    if len({*map(keys.name, keys.levels)}) < len(keys.levels):
        draft.note(["calibration", "levels"], f"must name each level once (got [{levels}])")
    if "runs" not in draft.values["evaluate"]:
        draft.note(["calibration"], "counts errors of runs, but no runs are evaluated: add `runs` to `evaluate`")


def shares(draft: DraftConfig, nx: int) -> list[Component]:
    """Return the metrics of each level of `calibration`, for all states and, of several, each; none after an error."""
    keys, path = draft.values["calibration"], ["calibration"]
    if keys is None or any(problem.path.startswith("calibration") for problem in draft.problems):
        return []
    found, mark = [], Mark(*locate(draft.tree, path))
    for of in ("joint", *(f"x.{i}" for i in range(nx) if nx > 1)):
        for level in keys.levels:
            given = {"kind": "coverage", "name": keys.name(level, of), "level": level, "of": of}
            given |= {} if keys.from_ is None else {"from": keys.from_}
            found.append(draft.component("metrics", Map(given, mark=mark), path))
    return [component for component in found if component is not None]


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
