"""What a stopping rule has decided so far, as plain data in the trial store."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, is_dataclass
from typing import TYPE_CHECKING, Any

import rmpc_bench
from rmpc_bench.analysis.looks import PlannedLook, planned_level, schedule
from rmpc_bench.config.sweep_point import digest

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.config.stop_section import StopKeys
    from rmpc_bench.store.store import Store

KEY = "stop"
"""Name under which the looks are stored."""


@dataclass(frozen=True)
class Looks:
    """The looks of a rule that have taken place; written after each of them.

    Parameters
    ----------
    key : hash of what the decisions depend on; looks of another key do not count
    runs : number of runs at each look
    wanted : number of runs that the experiment has or will have: that of the next look, or of the last one
    is_met : whether the rule was met at the last look
    open : what was not decided or resolved at the last look, in words
    """

    key: str
    runs: tuple[int, ...] = ()
    wanted: int = 0
    is_met: bool = False
    open: tuple[str, ...] = ()


@dataclass(frozen=True)
class StoredStop:
    """A stopping rule and what it has decided.

    Parameters
    ----------
    rule : the rule as the configuration writes it, such as ``decide: claims``
    max_runs : largest number of runs
    n_looks : number of planned looks at claims; 0 for a rule about widths, whose intervals do not depend on it
    level : level of each interval
    confidence : level that all looks have together
    looks : the looks that have taken place
    """

    rule: str
    max_runs: int
    n_looks: int
    level: float
    confidence: float
    looks: Looks

    @property
    def is_over(self) -> bool:
        """Whether no look follows."""
        return self.looks.is_met or bool(self.looks.runs) and self.looks.runs[-1] >= self.max_runs

    @property
    def is_unmet(self) -> bool:
        """Whether the largest number of runs is there and the rule is not met."""
        return self.is_over and not self.looks.is_met

    @property
    def planned(self) -> PlannedLook:
        """The look that the results rest on."""
        return PlannedLook(max(len(self.looks.runs), 1), self.n_looks, self.confidence)

    @property
    def text(self) -> str:
        """What the rule has decided, in words."""
        looks = self.looks
        of = f" of {self.n_looks}" if self.n_looks else ""
        look = f"look {len(looks.runs)}{of}, {looks.runs[-1]} runs" if looks.runs else "no look yet"
        if not self.is_over:
            return f"{self.rule}: not ended ({look}; the next one is at {looks.wanted} runs)"
        if looks.is_met:
            return f"{self.rule}: met at {look}"
        return f"{self.rule}: not met at {look}, the largest number; {'; '.join(looks.open)}"


def note_looks(store: Store, looks: Looks) -> None:
    """Store the looks in place of earlier ones."""
    store.set_meta(KEY, json.dumps(asdict(looks)))


def read_looks(store: Store) -> Looks | None:
    """Return the looks that a store has, of whatever rule; None where there is none."""
    data = store.data(KEY)
    try:
        return Looks(data["key"], tuple(data["runs"]), data["wanted"], data["is_met"], tuple(data["open"]))
    except KeyError:
        # Another version has written it; the looks are taken again.
        return None


def planned_looks(stop: StopKeys) -> tuple[int, ...]:
    """Return the numbers of runs of the looks at claims; empty for a rule about widths, which has any number."""
    return schedule(stop.first_look, stop.max_runs) if stop.decide else ()


def stop_of(config: ExperimentConfig, store: Store | None) -> StoredStop | None:
    """Return the rule of an experiment with the looks that its store has; None where there is none."""
    stop, confidence = config.stop, config.statistics.confidence
    if stop is None:
        return None
    key, planned = _key(config, stop), planned_looks(stop)
    found = None if store is None else read_looks(store)
    return StoredStop(
        rule=stop.text,
        max_runs=stop.max_runs,
        n_looks=len(planned),
        level=planned_level(confidence, len(planned)) if planned else confidence,
        confidence=confidence,
        looks=found if found is not None and found.key == key else Looks(key, wanted=stop.first_look),
    )


def _key(config: ExperimentConfig, stop: StopKeys) -> str:
    """Hash of everything that decisions depend on: the rule, the trials, and what is computed from them."""
    statistics = config.statistics
    trials = [[point.coordinates, point.method_keys, point.metric_keys] for point in config.points]
    claims = [[claim.check, claim.at, claim.pooled, claim.holds_for, claim.stated] for claim in config.claims]
    comparison = [config.primary, config.baseline, statistics.confidence, config.headline, statistics.average]
    margins = [statistics.relevant_change, statistics.margins]
    of_rule = claims if stop.decide else comparison + margins
    data = [asdict(stop), trials, of_rule, statistics.confidence, rmpc_bench.__version__]
    return digest(json.loads(json.dumps(data, default=_plain)))


def _plain(value: Any) -> Any:
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else dict(value)
