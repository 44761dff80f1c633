"""Tuning of a configuration: all searches advance together, round by round, and the values found are put into it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.config.experiment_config import ExperimentConfig, TuningPlan, WantedSearch
from rmpc_bench.config.identity import digest
from rmpc_bench.config.rounds import Trial
from rmpc_bench.engines.choice import ComputeOptions
from rmpc_bench.execution import progress_file
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.shards import Shard
from rmpc_bench.execution.tuning.rounds import Rounds, TuningProgress
from rmpc_bench.execution.tuning.search import Candidate, Row, plan
from rmpc_bench.received.store import WriteError, is_filled
from rmpc_bench.results.tuning import ANY_USE, Found, add_seconds, read_record, write_record
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array
from rmpc_bench.types.tuning import TuningProtocol

_Evaluated = dict[str, dict[Row, Array]]
"""Key of a search -> values -> metric of every tuning run."""


def with_known(config: ExperimentConfig, directory: Path) -> ExperimentConfig:
    """Return a configuration with the values that earlier searches have found; nothing is computed."""
    if config.tuning is None or not config.tuning.missing:
        return config
    return _with_values(config, _usable(read_record(directory), config.tuning))


def tuned(
    config: ExperimentConfig,
    directory: Path,
    *,
    shard: Shard | None = None,
    only: Collection[str] | None = None,
    how: ComputeOptions | None = None,
    progress: Progress | None = None,
    n_runs: int | None = None,
) -> ExperimentConfig:
    """Return a configuration with tuned values: those that are known, and those that are found here.

    The same call continues an interrupted one.  The directory of the results, or that of a shard, has or gets
    tuning.json and the trials of the tuning.  A shard uses the tuning.json of the whole experiment too.  `how` says
    how trials are computed.  With a stopping rule the regret waits for `n_runs`, the number of runs that were made.
    Raises as `rmpc_bench.execution.runner.compute`.
    """
    plan_of = config.tuning
    if plan_of is None:
        return config
    before, waits = None, config.stop is not None and n_runs is None
    if n_runs is not None:
        # The trials of the experiment are finished, which the file says again afterwards.
        before, plan_of = progress_file.read(directory), replace(plan_of, test_runs=n_runs)
        config = replace(config, tuning=plan_of)
    known = read_record(directory)
    if shard is not None:
        directory = shard.directory(directory)
        known |= read_record(directory)
    found = _usable(known, plan_of)
    left = _left(config, found, only, waits=waits)
    _make(directory)
    if left.any:
        _refuse_another(config, directory)
        shown = TuningProgress(directory, config, shard, progress or Progress(), left.title, left.n_trials)
        found |= _searched(Rounds(config, directory, how or ComputeOptions(), shown), left, found, shown)
    try:
        if any(each.key in found for each in plan_of.searches):
            write_record(directory, plan_of, found)
        if before is not None and left.any:
            progress_file.write(directory / progress_file.FILE, before)
    except OSError as error:
        raise WriteError(str(error)) from None
    return _with_values(config, found)


def _make(directory: Path) -> None:
    """Make the directory: progress.json is written into it before the first trial."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(str(error)) from None


class _Left(NamedTuple):
    """What is left to compute for a record."""

    plan: TuningPlan
    missing: Sequence[WantedSearch]  # searches that are not made
    untested: Sequence[WantedSearch]  # searches whose values are to be computed on the runs of the experiment
    tested: str  # what identifies these runs

    @property
    def any(self) -> bool:
        """Whether anything is left."""
        return bool(self.missing or self.untested)

    @property
    def n_trials(self) -> int:
        """Number of trials; a search whose values round to equal ones has fewer."""
        protocol = self.plan.protocol
        n_test = (protocol.budget + 1) * self.plan.test_runs
        return len(self.missing) * protocol.budget * protocol.runs + len(self.untested) * n_test

    @property
    def title(self) -> str:
        """What is computed, in words."""
        searches, protocol = self.missing or self.untested, self.plan.protocol
        names = {each.method for each in searches}
        n_points = len({each.number for each in searches})
        points = f" at {n_points} points" if n_points > 1 else ""
        size = f"{len(names)} method{'s' if len(names) > 1 else ''}{points} x {protocol.budget} values"
        if self.missing:
            return f"tuning: {size}, {protocol.runs} runs"
        return f"regret: {size}, {self.plan.test_runs} runs"


def _left(config: ExperimentConfig, found: Mapping[str, Found], only: Collection[str] | None, *, waits: bool) -> _Left:
    """Compare what is wanted of some methods with what was found; equal searches are made once."""
    assert config.tuning is not None
    wanted = [each for each in config.tuning.searches if only is None or each.method in only]
    # Of equal searches the first one.
    once = [*{each.key: each for each in reversed(wanted)}.values()][::-1]
    missing = [each for each in once if each.values is None and each.key not in found]
    tested = digest([config.hash, config.tuning.test_runs])
    untested = [each for each in once if each in missing or (each.key in found and found[each.key].tested != tested)]
    return _Left(config.tuning, missing, untested if config.tuning.regret and not waits else [], tested)


def _usable(found: Mapping[str, Found], plan_of: TuningPlan) -> dict[str, Found]:
    """Leave out short records where regret is wanted: ranks over other tuning runs need the runs of all values."""
    return {key: each for key, each in found.items() if not (plan_of.regret and each.is_short)}


def _refuse_another(config: ExperimentConfig, directory: Path) -> None:
    """Refuse a directory with the trials of another experiment, before anything is computed."""
    if is_filled(directory):
        with Store(directory, writable=False) as store:
            if store.meta("experiment") is not None:
                store.check(config.hash, config.shared, config.own.names())


def _with_values(config: ExperimentConfig, found: Mapping[str, Found]) -> ExperimentConfig:
    """Load a configuration with the values that were found for its searches."""
    assert config.tuning is not None and config.origin is not None
    known = {(each.point, each.method): found[each.key].values for each in config.tuning.missing if each.key in found}
    if not known:
        return config
    loaded: ExperimentConfig = config.origin.load(known)
    return loaded


def _searched(rounds: Rounds, left: _Left, known: Mapping[str, Found], progress: TuningProgress) -> dict[str, Found]:
    """Make the missing searches, and compute all values of the untested ones on the runs of the experiment."""
    try:
        with progress:
            found = {**known, **_tune(rounds, left.plan, left.missing)}
            found |= _test(rounds, left.untested, found, left.tested) if left.untested else {}
    finally:
        if rounds.seconds:
            add_seconds(rounds.directory, rounds.seconds)
    return found


def _tune(rounds: Rounds, plan_of: TuningPlan, searches: Sequence[WantedSearch]) -> dict[str, Found]:
    """Let all searches advance together, a round at a time, until none asks for more."""
    protocol, evaluated = plan_of.protocol, _Evaluated()
    while True:
        trials: dict[Trial, Row] = {}
        used: dict[str, tuple[Candidate, ...]] = {}
        for search in searches:
            values = evaluated.setdefault(search.key, {})
            known = {row: float(_objectives(protocol, runs)) for row, runs in values.items()}
            # The stream of tuning also says where the quasi-random points begin.
            wanted, used[search.key] = plan(
                search.parameters, protocol.budget, protocol.search, known, start=protocol.seed
            )
            numbers = {each.row: number for number, each in enumerate(used[search.key])}
            trials |= {Trial(search, numbers[each.row], each.row): each.row for each in wanted}
        if not trials:
            break
        for trial, runs in rounds.values([*trials]).items():
            evaluated[trial.search.key][trials[trial]] = runs
    return {search.key: _chosen(plan_of, search, used[search.key], evaluated[search.key]) for search in searches}


def _chosen(
    plan_of: TuningPlan, search: WantedSearch, used: Sequence[Candidate], evaluated: Mapping[Row, Array]
) -> Found:
    """Return what a search has found: the first of the values with the smallest objective, none if all are infinite."""
    tuning = np.array([evaluated[each.row] for each in used])
    objectives = _objectives(plan_of.protocol, tuning)
    return Found(
        **ANY_USE,
        method=search.method,
        parameters=search.parameters,
        default=search.default,
        candidates=np.array([each.row for each in used]),
        stages=tuple(each.stage for each in used),
        tuning=tuning,
        test=None,
        chosen=int(np.argmin(objectives)) if np.isfinite(objectives).any() else None,
    )


def _objectives(protocol: TuningProtocol, values: Float[Array, "... runs"]) -> Float[Array, ...]:
    """Return objectives with the digits with which the report compares them: the choice is the same on every CPU."""
    # pandas is imported where something is tuned.
    from rmpc_bench.analysis.tuning import objectives

    return objectives(protocol, values)


def _test(
    rounds: Rounds, searches: Sequence[WantedSearch], found: Mapping[str, Found], tested: str
) -> dict[str, Found]:
    """Compute all values of the searches, and the methods without tuning, on the runs of the experiment."""
    trials = [
        Trial(search, number, row)
        for search in searches
        for number, row in enumerate([*map(tuple, found[search.key].candidates.tolist()), None])
    ]
    values: dict[str, dict[int, Array]] = {search.key: {} for search in searches}
    for trial, row in rounds.values(trials, tested=True).items():
        values[trial.search.key][trial.number] = row
    return {
        search.key: replace(
            found[search.key],
            test=np.array([row for _, row in sorted(values[search.key].items())]),
            tested=tested,
            default=search.default,
        )
        for search in searches
    }
