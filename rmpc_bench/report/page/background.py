"""Folds on what stands behind the numbers of a page: settings, and what the comparison cannot show."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pandas as pd

from rmpc_bench.analysis.parameter_text import is_tuned, parameter_groups, parameter_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Finding
from rmpc_bench.report.page.parts import Fold, Part, Table
from rmpc_bench.report.page.source import PageSource
from rmpc_bench.report.ranks_table import LIMITATIONS


def settings_fold(source: PageSource) -> Fold:
    """Show the keys in which the methods differ, and what they share."""
    trials, differences, parts = source.trials, source.differences, list[Part]()
    keys = [*dict.fromkeys(key for row in differences.values() for key in row)]
    if keys and len(differences) > 1:
        columns = {"method": [*differences]}
        origins = [parameter_text(trials, name) or "-" for name in differences]
        columns |= {"parameters": origins} if len(set(origins)) > 1 else {}
        columns |= {key: [row.get(key, "-") for row in differences.values()] for key in keys}
        parts.append(Part(table=Table(columns, numeric=False, by_method=True)))
    parts += [Part(items=[f"{name}: {text}" for name, text in source.shared.items()])] if source.shared else []
    if trials.points:
        parts.append(Part(text=f"Sweep of {len(trials.points)} points over {', '.join(trials.paths)}."))
    if len(source.timings):
        columns = {str(name): [_cell(each) for each in source.timings[name]] for name in source.timings.columns}
        parts += [Part(text="Durations of the calls of components [s]:"), Part(table=Table(columns))]
    parts.append(Part(note="config.resolved.yaml has every key with its default."))
    n = len(trials.methods)
    uncertain = len(trials.each[0].uncertainty.columns) - 1
    gist = f"{n} method{'s' * (n > 1)}"
    gist += f", {uncertain} uncertain quantit{'y' if uncertain == 1 else 'ies'}" if uncertain > 0 else ""
    return Fold("Settings", gist, parts)


def _cell(value: Any) -> str:
    return "" if pd.isna(value) else f"{value:.3g}" if isinstance(value, float) else str(value)


def limits_fold(source: PageSource) -> Fold:
    """Say what the comparison cannot show."""
    items = [*_status_limits(source), *_comparison_limits(source)]
    gist = "; ".join(text.rstrip(".").partition(". ")[0] for text in items[:1])
    more = len(items) - 1
    return Fold(
        "Limits of this comparison",
        f"{gist} (and {more} more)" if more > 0 else gist,
        [Part(items=items)] if items else [],
    )


def _status_limits(source: PageSource) -> Iterator[str]:
    """Say where these are not the results of the configuration as it stands, and where findings have changed."""
    if source.overrides:
        yield f"The configuration was overridden ({', '.join(source.overrides)}); findings do not count."
    if source.incomplete:
        yield f"Runs are missing ({', '.join(source.incomplete)}); findings do not count."
    changed = sum(each.differs for each in source.verdicts)
    if changed and source.trials.with_verdicts:
        yield f"{changed} finding{'s' * (changed > 1)} changed since it was recorded."
    if source.trials.n_failed_trials:
        yield "Averages rest on the runs that both methods finished."
    yield from (f"A figure is missing: {text}." for text in source.left_out)
    if (source.manifest.get("git") or {}).get("dirty"):
        yield "The working tree had uncommitted changes when this was computed."


def _comparison_limits(source: PageSource) -> Iterator[str]:
    trials = source.trials
    if len(trials.methods) > 1:
        yield from _untuned(trials)
    yield from () if source.tuning is None else source.tuning.limitations
    yield from dict.fromkeys(text for table in trials.each for text in table.limitations)
    for name in sorted(trials.oracles):
        yield f"{name} knows the true parameters; no real estimator can do that."
    if source.confounded:
        yield (
            f"Both the estimator and the controller differ between {trials.baseline} and "
            f"{', '.join(source.confounded)}; the effect of one alone is not known."
        )
    yield from LIMITATIONS if source.ranked is not None else ()
    for verdict in source.verdicts:
        if verdict.joined is Finding.DEPENDS_ON_ASSUMPTIONS:
            yield f"The finding depends on unstated assumptions: {' '.join(verdict.claim.says.split())}."
    if trials.with_verdicts and len(trials.frame):
        yield "All numbers hold for this plant and these laws of its uncertain quantities and noises only."


def _untuned(trials: Trials) -> list[str]:
    """Name the methods that are not tuned, by where their parameters come from."""
    groups = parameter_groups(trials, trials.methods)
    left = {word: names for word, names in groups.items() if not is_tuned(trials, names[0])}
    if len(left) == len(groups) == 1:
        word = next(iter(left)).removesuffix(", not tuned")
        return [f"No parameter was tuned: all are {word}. Other parameters may change a verdict."]
    return [f"{', '.join(names)}: {word}; other parameters may change a verdict." for word, names in left.items()]
