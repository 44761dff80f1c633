"""What there is to tune in a configuration: the searches of all methods and points, and what identifies them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.claims.claim import usual_parameters
from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.identity import method_data
from rmpc_bench.config.sweep import SweptTree
from rmpc_bench.config.sweep_point import SweepPoint, digest
from rmpc_bench.config.tune_checks import metric_of_tuning
from rmpc_bench.config_file.component import without_path
from rmpc_bench.simulation.random_streams import words_of
from rmpc_bench.types.tuning import NOTHING_TUNED, OTHER_SETTINGS, TunedParameter, TuningProtocol

Chosen = Mapping[tuple[str, str], Mapping[str, float]]
"""Title of a point and name of a method -> path inside the method -> chosen value."""


class Origin(NamedTuple):
    """What a configuration was made from, to try values in it and to load it with those that are chosen."""

    points: Sequence[SweptTree]
    """The tree of every point of the sweep, before its validation."""
    access: CodeAccess
    smoke: bool
    load: Callable[[Chosen], Any]
    """Loads the configuration with chosen values and returns an ExperimentConfig; ConfigError as `load_config`."""


@dataclass(frozen=True, eq=False)
class WantedSearch:
    """The search of one method at one point of the sweep.

    Parameters
    ----------
    point : title of the point
    number : position of the point
    method : name of the method
    parameters : what is tuned
    default : value of each parameter without tuning; None where it is no number
    key : what identifies the search; equal searches have equal keys
    values : path -> chosen value; None where none is known, empty where nothing could be tuned
    """

    point: str
    number: int
    method: str
    parameters: tuple[TunedParameter, ...]
    default: tuple[float | None, ...]
    key: str
    values: Mapping[str, float | int] | None
    settings: str
    """What identifies the search but for the code: config.resolved.yaml keeps it with the values."""
    carried: str
    """The same of the search that has found the values; the one of this search where the file has no values."""


@dataclass(frozen=True, eq=False)
class TuningPlan:
    """All searches of a configuration.

    Parameters
    ----------
    protocol : the same for all of them
    regret : whether all values are also computed on the runs of the experiment
    searches : every tuned method at every point
    seeds : seed of the tuning runs at every point
    folder : identifies the tuning runs, as the hash of an experiment does its runs
    test_runs : number of runs of the experiment on which values are compared; the largest one with a stopping rule
    """

    protocol: TuningProtocol
    regret: bool
    searches: tuple[WantedSearch, ...]
    seeds: tuple[int, ...]
    folder: str
    test_runs: int

    @property
    def missing(self) -> tuple[WantedSearch, ...]:
        """Searches without a chosen value."""
        return tuple(each for each in self.searches if each.values is None)

    @property
    def data(self) -> dict[str, Any]:
        """What is tuned and how, as plain data, without what was chosen."""
        ranges = {f"{each.point}/{each.method}": [vars(one) for one in each.parameters] for each in self.searches}
        return {"protocol": vars(self.protocol), "ranges": ranges}

    def words(self, method: str, default: str) -> str:
        """Say where the parameters of a method come from; `default` is said of those that stay in the file."""
        searches = [each for each in self.searches if each.method == method]
        if any(each.carried != each.settings for each in searches):
            return OTHER_SETTINGS
        n_found = sum(each.values is None or bool(each.values) for each in searches)
        if not n_found:
            return f"{default} {NOTHING_TUNED}"
        words = self.protocol.words
        return words if n_found == len(searches) else f"{words[:-1]}, {n_found} of {len(searches)} points)"

    def n_trials(self, methods: Sequence[str] | None = None) -> tuple[int, int]:
        """Return the largest numbers of trials on tuning runs and, for the regret, on the runs of the experiment."""
        wanted = [each for each in self.missing if methods is None or each.method in methods]
        n = len({each.key for each in wanted})
        tested = n * (self.protocol.budget + 1) * self.test_runs if self.regret else 0
        return n * self.protocol.budget * self.protocol.runs, tested


def tuning_seed(seed: int, number: int) -> int:
    """Return the seed of the tuning runs of an experiment by the number of their stream.

    Examples
    --------
    >>> tuning_seed(1, 0) != tuning_seed(1, 1) != 1
    True
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(*words_of("tuning"), number))
    high, low = (int(word) for word in sequence.generate_state(2, np.uint32))
    return (high >> 1) << 32 | low


def tuning_plan(drafts: Sequence[DraftConfig], points: Sequence[SweepPoint]) -> TuningPlan | None:
    """Return what there is to tune in a valid configuration; None where no method is tuned."""
    tune = drafts[0].values["tune"]
    if tune is None or not drafts[0].tuned:
        return None
    protocol = tune.protocol(metric_of_tuning(drafts[0]))
    seeds = [tuning_seed(draft.values["seed"], protocol.seed) for draft in drafts]
    shared = [digest({**point.shared, "seed": seed}) for point, seed in zip(points, seeds, strict=True)]
    searches = [
        _search(draft, point, number, name, protocol, shared[number])
        for number, (draft, point) in enumerate(zip(drafts, points, strict=True))
        for name in draft.tuned
    ]
    folder, test_runs = digest(sorted(set(shared))), points[0].experiment.n_runs
    return TuningPlan(protocol, tune.regret, tuple(searches), tuple(seeds), folder, test_runs)


def _search(
    draft: DraftConfig, point: SweepPoint, number: int, name: str, protocol: TuningProtocol, shared: str
) -> WantedSearch:
    tuned = draft.tuned[name]
    data = {
        "experiment": shared,
        "method": method_data(draft, tuned.lowest, without_path),
        "ranges": [vars(each) for each in tuned.parameters],
        # The number of the stream is in the seed.
        "protocol": {each: value for each, value in vars(protocol).items() if each not in ("metric", "seed")},
        "metric": point.metric_keys[protocol.metric],
    }
    key, settings = digest({**data, "code": point.code[name]}), digest(data)[:16]
    carried = next((row.key for row in draft.rows if row.method == name), settings)
    found = (tuned.parameters, tuned.default, key, tuned.values, settings, carried)
    return WantedSearch(draft.title, number, name, *found)


def parameter_words(draft: DraftConfig, plan: TuningPlan | None) -> dict[str, str]:
    """Say for every method where its parameters come from."""
    usual = usual_parameters(draft.values["paper"])
    words = {name: draft.sources.get(name, usual) for name in draft.methods}
    return words if plan is None else {**words, **{name: plan.words(name, words[name]) for name in draft.tuned}}
