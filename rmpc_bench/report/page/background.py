"""What stands behind the numbers of a page: methods and assumptions, limitations, failures, timing, and checks."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from rmpc_bench.analysis.parameter_text import is_tuned, parameter_groups, parameter_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Finding
from rmpc_bench.report.page.blocks import Block, Text, bullets, code, facts, heading, paragraph, table
from rmpc_bench.report.page.result_tables import inconclusive
from rmpc_bench.report.page.source import PageSource
from rmpc_bench.report.run_notes import failed_runs, failed_sentences, held_sentences, of_run, show_command
from rmpc_bench.report.tables import declared_lines, status_lines

MOST_LISTED = 6
"""Entries of a list that a section of the page shows."""


def method_blocks(source: PageSource) -> list[Block]:
    """Return the keys in which the methods differ, what they share, and the assumptions."""
    blocks: list[Block] = []
    differences = source.differences
    keys = [*dict.fromkeys(key for row in differences.values() for key in row)]
    if keys and len(differences) > 1:
        columns: dict[str, list[Text]] = {"method": [*differences]}
        origins: list[Text] = [parameter_text(source.trials, name) or "-" for name in differences]
        columns |= {"parameters": origins} if source.trials.parameters else {}
        columns |= {key: [row.get(key, "-") for row in differences.values()] for key in keys}
        numbers = [_number(source, name) for name in differences]
        blocks.append(table("Keys of the configuration in which the methods differ", {**columns}, methods=numbers))
    elif groups := parameter_groups(source.trials, source.trials.methods):
        blocks += facts([("Parameters", f"{', '.join(names)}: {word}") for word, names in groups.items()])
    if source.shared:
        blocks += [heading("The same for every method"), *facts([*source.shared.items()])]
    if source.trials.paths:
        swept = ", ".join(source.trials.paths)
        blocks.append(paragraph(f"Sweep of {len(source.trials.points)} points over {swept}."))
    assumed = dict.fromkeys(text for verdict in source.verdicts for text in verdict.claim.assumptions)
    if assumed:
        blocks += [heading("Assumptions: what the paper does not state"), *bullets([*map(_line, assumed)])]
    return blocks


def _number(source: PageSource, name: str) -> int | None:
    return source.trials.all_methods.index(name) if name in source.trials.all_methods else None


def limitation_blocks(source: PageSource) -> list[Block]:
    """Return the known limitations of the comparison."""
    return bullets([*_status_limits(source), *_comparison_limits(source), *_machine_limits(source)])


def _status_limits(source: PageSource) -> list[Text]:
    """Say where these are not the results of the configuration as it stands, and where findings have changed."""
    found: list[Text] = []
    if source.overrides:
        found.append(f"The configuration was overridden ({', '.join(source.overrides)}); findings do not count.")
    if source.incomplete:
        found.append(f"Runs are missing ({', '.join(source.incomplete)}); findings do not count.")
    changed = sum(each.differs for each in source.verdicts)
    if changed:
        found.append(f"{_count(changed, 'finding')} changed since it was recorded.")
    failed = source.trials.n_failed_trials
    if failed:
        found.append(f"{_count(failed, 'trial')} failed. Averages rest on the runs that both methods finished.")
    elif all(point.computed(*point.methods).all() for point in source.trials.each):
        found += ["No run failed, so that no average leaves a run out."] if len(source.trials.frame) else []
    else:
        found.append("No run failed. Comparisons leave out the runs that are not computed for both methods.")
    return [*found, *(f"A figure is missing: {text}." for text in source.left_out)]


def _comparison_limits(source: PageSource) -> list[Text]:
    """Say what the comparison cannot show."""
    trials, found = source.trials, list[Text]()
    if len(trials.methods) > 1:
        found += _untuned(trials)
    found += [] if source.tuning is None else source.tuning.limitations
    found += dict.fromkeys(text for table in trials.each for text in table.limitations)
    for name in sorted(trials.oracles):
        found.append(f"{name} knows the true parameters; no real estimator can do that.")
    if source.confounded:
        names = ", ".join(source.confounded)
        found.append(
            f"Both the estimator and the controller differ between {trials.baseline} and {names}; the effect of one "
            "alone is not known."
        )
    undecided = inconclusive(source.tables)
    found += [f"Inconclusive: {text}." for text in undecided[:MOST_LISTED]]
    if len(undecided) > MOST_LISTED:
        found.append(f"{len(undecided) - MOST_LISTED} more comparisons are inconclusive.")
    for verdict in source.verdicts:
        if verdict.joined is Finding.DEPENDS_ON_ASSUMPTIONS:
            found.append(f"The finding depends on unstated assumptions: {_line(verdict.claim.says)}.")
    assumed = {text for verdict in source.verdicts for text in verdict.claim.assumptions}
    if assumed:
        found.append(
            f"The claims rest on {_count(len(assumed), 'assumption')} that the paper does not state (listed above); "
            "another choice may change a finding."
        )
    if trials.with_verdicts and len(trials.frame):
        found.append("All numbers hold for this plant and these laws of its uncertain quantities and noises only.")
    return found


def _untuned(trials: Trials) -> list[Text]:
    """Name the methods that are not tuned, by where their parameters come from."""
    groups = parameter_groups(trials, trials.methods)
    left = {word: names for word, names in groups.items() if not is_tuned(trials, names[0])}
    if len(left) == len(groups) == 1:
        word = next(iter(left)).removesuffix(", not tuned")
        return [f"No method is tuned: all parameters are {word}. Other parameters may change a verdict."]
    return [f"{', '.join(names)}: {word}; other parameters may change a verdict." for word, names in left.items()]


def _machine_limits(source: PageSource) -> list[Text]:
    platform, git = source.manifest.get("platform") or {}, source.manifest.get("git") or {}
    found: list[Text] = []
    if platform:
        found.append(
            f"Computed on one machine ({platform.get('system')}); elsewhere the last digits of the numbers may differ."
        )
    if git.get("dirty"):
        found.append("The working tree had uncommitted changes when this was computed.")
    return found


def failure_blocks(source: PageSource) -> list[Block]:
    """Return failed runs with the command that replays them, held and failed steps, warnings, and the time taken."""
    blocks: list[Block] = []
    for trials in source.trials.each:
        lines: list[Text] = [text.removeprefix("- ") for text in (*status_lines(trials), *declared_lines(trials))]
        blocks += [paragraph(f"{trials.title}:")] if trials.title and lines else []
        blocks += bullets(lines)
    failed = [(trials, name, run) for trials in source.trials.each for name, run in failed_runs(trials)]
    commands: list[Text] = [
        [f"{of_run(trials, name, run)}: ", code(show_command(trials, source.place, name, run))]
        for trials, name, run in failed[:MOST_LISTED]
    ]
    blocks += [heading("Failed runs to replay"), *bullets(commands)] if commands else []
    held = [text for trials in source.trials.each for text in held_sentences(trials)]
    blocks += bullets([f"Held: {text}" for text in held[:MOST_LISTED]])
    steps = [text for trials in source.trials.each for text in failed_sentences(trials)]
    blocks += bullets([f"Steps: {text}" for text in steps[:MOST_LISTED]])
    warned = dict.fromkeys(
        " ".join(text.split())
        for trials in source.trials.each
        for each in trials.notes.values()
        for text in each.warnings
    )
    blocks += bullets([f"Warning of a component: {text}" for text in [*warned][:MOST_LISTED]])
    if not blocks and len(source.trials.frame):
        blocks = [paragraph("No run failed.")]
    return [*blocks, *_timing(source)]


def _timing(source: PageSource) -> list[Block]:
    """Return how long the computation took, and the durations of the calls of own components."""
    blocks: list[Block] = []
    seconds = [_seconds(session) for session in source.manifest.get("sessions", [])]
    known = [each for each in seconds if each is not None]
    if known and max(known) > 0:
        cores = (source.manifest.get("platform") or {}).get("cores")
        on = f" on a machine with {cores} cores" if cores else ""
        blocks.append(paragraph(f"Computing all runs took {max(known):.0f} s{on}."))
    if len(source.timings):
        columns = {str(name): [_cell(value) for value in source.timings[name]] for name in source.timings.columns}
        blocks.append(table("Durations of the calls of components [s]", {**columns}))
    return blocks


def _seconds(session: Mapping[str, Any]) -> float | None:
    try:
        start, stop = (datetime.fromisoformat(session[key]) for key in ("start", "stop"))
    except (KeyError, TypeError, ValueError):
        return None
    return (stop - start).total_seconds()


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def trust_blocks(source: PageSource) -> list[Block]:
    """Return the reasons to trust the numbers, each with the command that checks it."""
    trials, record = source.trials, source.record
    file = shlex.quote(shlex.split(record["command"])[2])
    first = next((name for name in trials.methods), "")
    rows: list[tuple[str, str]] = []
    n_runs = len(trials.each[0].runs)
    if n_runs:
        points = f" at each of {len(trials.points)} points" if trials.points else ""
        rows.append(
            (
                f"{n_runs} runs per method{points} are stored, {trials.n_failed_trials} trials failed; "
                "this page is made from them again without simulation.",
                shlex.join(["rmpc-bench", "report", source.place]),
            )
        )
        rows.append(
            (
                f"Seed {trials.seed} and the index of a run determine all its random numbers, the same for every "
                "method; a run is replayed bit for bit.",
                show_command(trials.each[0], source.place, first, int(trials.each[0].runs[0])),
            )
        )
    agreeing = sum(not verdict.differs for verdict in source.verdicts if verdict.claim.finding is not None)
    recorded = sum(verdict.claim.finding is not None for verdict in source.verdicts)
    if recorded:
        rows.append(
            (
                f"{agreeing} of {recorded} findings are those recorded in the configuration; with --strict a "
                "difference leads to exit code 1.",
                f"rmpc-bench run {file} --strict",
            )
        )
    rows.append(
        (
            f"The experiment hash {record['hash'][:12]} covers all that determines the numbers; a directory with "
            "another hash is refused with exit code 5.",
            record["command"],
        )
    )
    rows.append(
        (
            "Plant and design model, differences between the methods and convergence of the gains are listed before "
            "any run.",
            f"rmpc-bench check {file} --deep",
        )
    )
    return [{"kind": "checks", "items": [{"reason": reason, "command": command} for reason, command in rows]}]


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _line(text: str) -> str:
    return " ".join(text.split())
