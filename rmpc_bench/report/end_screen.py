"""The text at the end of a run: the runs, the table of the primary metric, what drives it, claims and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.run_notes import screen_lines

SMOKE_CLAIMS = "claims      not evaluated: a smoke run is too short, claims.md is for information only"


def end_screen(
    trials: Trials,
    table: str,
    *,
    directory: Path,
    n_complete: int,
    n_runs: int,
    seconds: float | None,
    driven: Sequence[str],
    tuned: Sequence[str] = (),
    verdicts: Sequence[ClaimVerdict],
    overrides: Sequence[str],
    incomplete: Sequence[str],
    files: Sequence[str],
    stop: str = "",
) -> str:
    """Lay out the text at the end of a run; that of a smoke run has no verdicts and no findings.

    `n_complete` counts runs that are stored of all methods, of `n_runs`; both are 0 for exact moments alone.  The run
    took some seconds [s], left out where None.  `driven`, `tuned` and `stop` say what drives the metric, how parameters
    were chosen, and what a stopping rule has decided.  Overrides are options that changed the configuration,
    `incomplete` methods of which runs are missing.  Files are relative to the directory of the results.
    """
    lines = [_head(trials, directory, n_complete, n_runs, seconds), "", *_indented(table.split("\n")), ""]
    lines += _indented([f"{'stop':12}{stop}"] if stop else [])
    lines += _indented([*tuned, *driven])
    if verdicts and not trials.with_verdicts:
        lines += _indented([SMOKE_CLAIMS])
    else:
        lines += _indented(_claim_lines(verdicts, overrides, incomplete))
    lines += _indented(screen_lines(trials, directory))
    lines += _indented([f"{'open':12}{'   '.join(files)}"])
    return "\n".join(lines)


def _head(trials: Trials, directory: Path, n_complete: int, n_runs: int, seconds: float | None) -> str:
    points = f" at each of {len(trials.points)} points" if trials.points else ""
    name = trials.name if trials.with_verdicts else f"{trials.name} (smoke run, no verdicts)"
    if not n_runs:
        return f"{name}   exact moments{points}, no runs   {directory}"
    done = f" done in {seconds:.1f} s" if seconds is not None else ""
    runs = f"{n_complete} of {n_runs} runs{points}, {trials.n_failed_trials} failed"
    return f"{name}{done}   {runs}   {directory}"


def _claim_lines(verdicts: Sequence[ClaimVerdict], overrides: Sequence[str], incomplete: Sequence[str]) -> list[str]:
    """Say where the claims are, and name those whose finding differs from the record; their findings are no score."""
    if not verdicts:
        return []
    reasons = [f"the configuration was overridden ({', '.join(overrides)})"] if overrides else []
    reasons += [f"runs are missing ({', '.join(incomplete)})"] if incomplete else []
    if reasons:
        return [f"claims      not evaluated: {'; '.join(reasons)}"]
    n_of_paper = sum(each.claim.of_paper for each in verdicts)
    counts = ((n_of_paper, "statement", " of the paper"), (len(verdicts) - n_of_paper, "additional result", ""))
    texts = [f"{n} {noun}{'' if n == 1 else 's'}{of}" for n, noun, of in counts if n]
    return [f"claims      claims.md: {', '.join(texts)}"] + [
        f"{'':12}recorded {verdict.claim.finding}, now {verdict.finding}: {verdict.claim.says}"
        for verdict in verdicts
        if verdict.differs
    ]


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" if line else line for line in lines]
