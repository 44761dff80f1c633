"""Everything that is derived from stored trials: tables, figures, claims, and the screen at the end."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from rmpc_bench import registry
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.table import claims_table
from rmpc_bench.claims.verdict import ClaimVerdict, judge
from rmpc_bench.cli import exits
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution import results
from rmpc_bench.figures.kinds import save
from rmpc_bench.report.summary import summarise, trials_csv, write_csv
from rmpc_bench.types import Array, DesignError


class Outcome(NamedTuple):
    """What a run has come to."""

    screen: str
    n_failed: int
    max_failures: int
    judged: bool
    """Whether claims were judged: the configuration as it stands, in full."""
    differing: int
    """Claims whose finding differs from its record, on the unmodified configuration."""

    def code(self, *, strict: bool) -> int:
        """Exit code, the gravest first."""
        if self.n_failed > self.max_failures:
            return exits.TOO_MANY_FAILURES
        return exits.FINDING_DIFFERS if strict and self.differing else 0


def publish(
    config: ExperimentConfig,
    directory: Path,
    modified: Sequence[str],
    *,
    started: float | None = None,
) -> Outcome:
    """Write all derived files of a directory and return the screen.

    Parameters
    ----------
    config : the experiment
    directory : where its trials are stored
    modified : what was changed against the file; claims are then shown for information only
    started : monotonic time at which the command began, for the screen
    """
    trials = results.stored_trials(config, directory)
    summary = summarise(trials)
    trials_csv(trials, directory / "trials.csv")
    write_csv(results.uncertainty(config, directory), directory / "uncertainty.csv")
    write_csv(trials.series, directory / "series.csv")
    write_csv(summary.described.drop(columns="never"), directory / "summary.csv")
    write_csv(summary.compared, directory / "comparisons.csv")
    _write_traces(trials, directory / "traces.npz")
    (directory / "tables").mkdir(exist_ok=True)
    (directory / "tables" / "summary.md").write_text(summary.to_markdown(), encoding="utf-8")
    n_complete = results.n_complete(config, directory)
    modified = [*modified, *_incomplete(config, n_complete)]
    verdicts = [judge(claim, trials) for claim in config.claims]
    for name in ("claims.json", "claims.md"):
        (directory / name).unlink(missing_ok=True)  # of an earlier configuration
    if verdicts:
        (directory / "claims.json").write_text(json.dumps(claims_table(verdicts), indent=2) + "\n", encoding="utf-8")
        text = claims_markdown(verdicts, informational=bool(modified))
        (directory / "claims.md").write_text(text, encoding="utf-8")
    figures = _figures(config, trials, directory)
    head = _head(config, trials, n_complete, directory, started)
    block = summary.to_screen(config.primary)
    foot = _foot(verdicts, modified, directory, figures)
    differing = [] if modified else [verdict for verdict in verdicts if verdict.differs]
    return Outcome(
        screen="\n".join([head, "", _indented(block), "", *foot]),
        n_failed=results.n_failed(trials),
        max_failures=config.execution.max_failures,
        judged=bool(verdicts) and not modified,
        differing=len(differing),
    )


def _incomplete(config: ExperimentConfig, n_complete: Mapping[str, int]) -> list[str]:
    """Say what is still missing: an interrupted experiment is not one at full size."""
    n_runs = config.experiment.n_runs if "runs" in config.evaluate else 0
    return [f"{name}: {n} of {n_runs} runs" for name, n in n_complete.items() if n < n_runs]


def _write_traces(trials: Trials, path: Path) -> None:
    """Write the recorded runs: t, r and, for every point, method and signal, an array (runs, samples, components)."""
    path.unlink(missing_ok=True)  # of an earlier configuration
    arrays: dict[str, Array] = {}
    for table in trials.each:
        for method, trace in table.traces.items():
            where = "/".join(part for part in (table.title, method) if part)
            own = {name: f"{name}_reported" for name in ("runs", "r", "t")}  # of a method that reports such a signal
            arrays |= {f"{where}/{own.get(signal, signal)}": array for signal, array in trace.signals.items()}
            arrays |= {f"{where}/runs": trace.runs, f"{where}/r": trace.r}
            arrays[f"{where}/t"] = np.round((table.Ts or 1.0) * np.arange(len(trace.r)), 12)
    if arrays:
        np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def _figures(config: ExperimentConfig, trials: Trials, directory: Path) -> list[Path]:
    paths: list[Path] = []
    kinds: Counter[str] = Counter()
    for part in config.figures:
        kinds[part.kind] += 1
        stem = part.kind if kinds[part.kind] == 1 else f"{part.kind}-{kinds[part.kind]}"
        try:
            keys = dict(part.parameters)
            if keys.get("metric", "") is None:
                keys["metric"] = config.primary
            figure = registry.get("figures", part.kind)(trials, **keys)
        except DesignError as error:  # a method it shows has not been computed yet
            click.echo(f"figure {part.kind} left out: {error}", err=True)
        else:
            paths += save(figure, directory / "figures", stem)
    return paths


def _head(
    config: ExperimentConfig, trials: Trials, n_complete: Mapping[str, int], directory: Path, started: float | None
) -> str:
    n_runs = config.experiment.n_runs
    complete = min(n_complete[name] for name in trials.methods)
    points = f" at each of {len(trials.points)} points" if trials.points else ""
    failed = results.n_failed(trials)
    if "runs" not in config.evaluate:
        return f"{config.name}   exact moments{points}, no runs   {directory}"
    done = f" done in {time.monotonic() - started:.1f} s" if started is not None else ""
    return f"{config.name}{done}   {complete} of {n_runs} runs{points}, {failed} failed   {directory}"


def _foot(
    verdicts: Sequence[ClaimVerdict], modified: Sequence[str], directory: Path, figures: Sequence[Path]
) -> list[str]:
    lines = []
    if verdicts and modified:
        lines.append(f"paper       not judged: not the configuration as it stands, in full ({', '.join(modified)})")
    elif verdicts:
        of_paper = [verdict for verdict in verdicts if verdict.claim.of_paper]
        if of_paper:
            found = sum(verdict.finding == "confirmed" for verdict in of_paper)
            lines.append(f"paper       {found} of {len(of_paper)} statements found as written (claims.md)")
        if len(of_paper) < len(verdicts):
            beyond = [verdict for verdict in verdicts if not verdict.claim.of_paper]
            found = sum(verdict.finding == "confirmed" for verdict in beyond)
            lines.append(f"beyond it   {found} of {len(beyond)} statements of our own found (claims.md)")
        lines += [
            f"            recorded {verdict.claim.finding}, now {verdict.finding}: {verdict.claim.says}"
            for verdict in verdicts
            if verdict.differs
        ]
    shown = [path for path in figures if path.suffix == ".png"]
    lines += [f"{'open' if path is shown[0] else '':12}{path}" for path in shown]
    return [_indented(line) for line in lines]


def _indented(text: str) -> str:
    return "\n".join(f"    {line}" if line else line for line in text.split("\n"))
