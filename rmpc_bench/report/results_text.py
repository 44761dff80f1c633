"""The comparison of the results of two directories as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import pandas as pd

from rmpc_bench.analysis.trial_differences import Largest, MetricDifference, TrialDifferences

MOST_LINES = 20
"""Lines of one kind that are shown; the rest is counted."""


class Setting(Protocol):
    """A setting that differs."""

    @property
    def path(self) -> str:
        """Where it stands."""

    @property
    def a(self) -> str:
        """Its value in the first experiment."""

    @property
    def b(self) -> str:
        """Its value in the second experiment."""


class FindingDifference(NamedTuple):
    """A claim with two findings."""

    claim: str
    a: str
    b: str


@dataclass(frozen=True, eq=False)
class ResultsComparison:
    """How the results of two directories differ.

    Parameters
    ----------
    names : the two directories
    sizes : name, numbers of runs, methods and metrics, and seed of either
    settings : what differs in the configurations
    trials : what differs in the trials
    findings : claims of both whose computed findings differ
    """

    names: tuple[str, str]
    sizes: tuple[str, str]
    settings: tuple[Setting, ...]
    trials: TrialDifferences
    findings: tuple[FindingDifference, ...]

    @property
    def equal(self) -> bool:
        """Whether trials and findings are equal; settings may differ where they change no number."""
        return self.trials.equal and not self.findings

    def to_frame(self) -> pd.DataFrame:
        """Return the compared metrics: point, method, metric, counts and the largest differences with their runs."""
        rows = [
            {
                **{"point": each.point, "method": each.method, "metric": each.metric},
                **{"n": each.n, "n_differ": each.n_differ},
                **{"relative": each.relative.size, "relative_run": each.relative.run},
                **{"absolute": each.absolute.size, "absolute_run": each.absolute.run, "n_apart": each.n_apart},
            }
            for each in self.trials.values
        ]
        return pd.DataFrame(rows)

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        for letter, name, size in zip("AB", self.names, self.sizes, strict=True):
            yield f"{letter}  {name}   {size}"
        sections = {
            "settings that differ": [f"{each.path}: A {each.a}, B {each.b}" for each in self.settings],
            "only in one": _alone(self.trials),
            "statuses that differ": [
                f"{_where(each.point, each.method)} run {each.run}: A {each.a}, B {each.b}"
                for each in self.trials.statuses
            ],
            "metrics that differ": [_metric(each) for each in self.trials.differing],
            "findings that differ": [f"{each.claim}: A {each.a}, B {each.b}" for each in self.findings],
        }
        for title, lines in sections.items():
            if lines:
                yield from ("", title, *_shortened(lines))
        yield ""
        yield self._conclusion()

    def _conclusion(self) -> str:
        trials = self.trials
        basis = f"{trials.n_trials} trials in both, {trials.n_values} values of metrics"
        rule = f"up to a relative difference of {trials.tolerance:g}" if trials.tolerance else "exact"
        if self.equal:
            return f"equal ({rule}): {basis}, all statuses"
        if not trials.n_trials:
            return "different: no trial is in both"
        n_values = sum(each.n_differ for each in trials.values)
        counts = [(n_values, "value"), (len(trials.statuses), "status"), (len(self.findings), "finding")]
        texts = [f"{n} {noun}{'' if n == 1 else 'es' if noun == 'status' else 's'} differ" for n, noun in counts if n]
        texts += ["one has more than the other"] if _alone(trials) else []
        return f"different ({rule}): {', '.join(texts)}; compared: {basis}"


def _alone(trials: TrialDifferences) -> list[str]:
    """Say what only one of the two has."""
    lines = []
    for noun, pair in (("method", trials.methods), ("metric", trials.metrics), ("point", trials.points)):
        for letter, names in zip("AB", pair, strict=True):
            lines += [f"{letter}: {noun} {name}" for name in names]
    groups: dict[tuple[str, str], list[str]] = {}
    for each in trials.runs:
        for letter, runs in (("A", each.runs_a), ("B", each.runs_b)):
            if runs:
                groups.setdefault((letter, _ranges(runs)), []).append(_where(each.point, each.method))
    return lines + [f"{letter}: runs {runs} of {', '.join(where)}" for (letter, runs), where in groups.items()]


def _ranges(runs: Sequence[int]) -> str:
    """Write ascending numbers, consecutive ones as a range.

    Examples
    --------
    >>> _ranges([0, 1, 2, 7, 9, 10])
    '0-2, 7, 9-10'
    """
    parts: list[list[int]] = []
    for run in runs:
        if parts and run == parts[-1][1] + 1:
            parts[-1][1] = run
        else:
            parts.append([run, run])
    texts = [str(first) if first == last else f"{first}-{last}" for first, last in parts]
    return ", ".join(texts[:MOST_LINES]) + (f" and {len(texts) - MOST_LINES} more" if len(texts) > MOST_LINES else "")


def _metric(each: MetricDifference) -> str:
    texts = [f"{_where(each.point, each.method)} {each.metric}: {each.n_differ} of {each.n} runs"]
    if each.n_apart:
        pair = f"A {each.apart.a!r}, B {each.apart.b!r}"
        texts.append(f"one of the values is inf or missing in {each.n_apart}, first in run {each.apart.run} ({pair})")
    if each.relative.size:
        together = "" if each.absolute.run != each.relative.run else f", absolute {each.absolute.size:.3g}"
        texts.append(f"largest relative difference {_largest(each.relative)}{together}")
        texts += [] if together else [f"largest absolute difference {_largest(each.absolute)}"]
    return "; ".join(texts)


def _largest(each: Largest) -> str:
    return f"{each.size:.3g} in run {each.run} (A {each.a!r}, B {each.b!r})"


def _where(point: str, method: str) -> str:
    return f"{point}: {method}" if point else method


def _shortened(lines: Sequence[str]) -> list[str]:
    shown = [f"  {line}" for line in lines[:MOST_LINES]]
    return shown + ([f"  and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else [])
