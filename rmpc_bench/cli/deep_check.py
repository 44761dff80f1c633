"""What `check --deep` and `--shards` compute: mismatch of plant and design model, own components, time and memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.cli.shared_options import imported
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config_file.component import build_component
from rmpc_bench.config_file.tree import kind_of
from rmpc_bench.diagnostics.mismatch import STEADY, GainConvergence, MethodMismatch, Mismatch, model_mismatch
from rmpc_bench.execution.pilot import PilotError, measure, runs_of_shard
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types.texts import in_columns

if TYPE_CHECKING:
    from rmpc_bench.types import Array

MAX_POINTS = 12  # points of a sweep that are analysed, the first ones
DIVERGENCE = "  divergence of the plant from the design model, a guide for the tolerance c"
LOOPS = "  linear closed loop without friction, limits, delays and gaps: spectral radius, convergence of the gain"
CAPTION = (
    "  s: standard deviation of the plant's noise divided by that of the design model",
    "  The gains do not depend on s; the mean part grows as 1 / s^2.  Friction and limits, which make the true density",
    "  non-normal, are left out.  States that the design model lacks are marginalised.  The process noise of the plant",
    "  is that of the design model.  With `kl: printed`, c is compared with twice (10).",
)
NOISE = {
    "measurement": "s of the measurement noise",
    "process": "s of the process noise",
    "none": "no noise, so s = 0",
    "unknown": "s is not known for this noise law",
}
INDENT = "    "  # of the rows of a table
WIDTH = 110  # characters of a line on own components
TITLE = "  own components, checked on the linear system of their design model (all checks: check --component)"
RESERVE = 1.5  # ratio of the time limit of a shard to its estimated time, before a minute is added
MINUTE = 60.0


def mismatch_lines(config: ExperimentConfig) -> list[str]:
    """Return the lines of every point of a sweep, each under its title, and the caption."""
    lines: list[str] = []
    known: dict[str, GainConvergence] = {}
    explained = False
    with single_thread():
        for point in config.points[:MAX_POINTS]:
            found = model_mismatch(
                point.experiment,
                point.methods,
                plant=kind_of(point.shared["plant"]),
                baseline=config.baseline,
                build=build_component,
                known=known,
            )
            explained |= found.n_plants > 0
            lines += ["", f"  {point.title}"] if point.title else []
            lines += ["", *divergence_lines(found), "", *loop_lines(found)]
            lines += [f"  warning: {text}" for text in warnings(found, config.baseline)]
    left = len(config.points) - MAX_POINTS
    lines += ["", f"  and {left} more points, not analysed"] if left > 0 else []
    return lines + (["", *CAPTION] if explained else [])


def divergence_lines(found: Mismatch) -> list[str]:
    """Return the table of the divergence of the plants, with the configured tolerance c."""
    if not found.n_plants:
        return [f"{DIVERGENCE}: not available for plant {found.plant}"]
    counted = f"mean [range] of the first {found.n_plants} plants" if found.n_plants > 1 else "one plant"
    compared = [each.noise for each in found.methods.values() if not isinstance(each.divergence, str)]
    compared = compared or [each.noise for each in found.methods.values()]
    noise = " or ".join(dict.fromkeys(NOISE[one.channel] for one in compared))
    scales = {one.scale for one in compared}
    (common,) = scales if len(scales) == 1 else (None,)
    at_scale = "" if scales == {None} else "mean part at s" if common is None else f"mean part at s = {common:.3g}"
    rows: list[tuple[str, ...]] = [("", "c", "covariance part", "mean part", at_scale)]
    for name, each in found.methods.items():
        rows.append((name, "-" if each.c is None else f"{each.c:g}", *_parts(each, show_scale=common is None)))
    averaged = f"  (10) of zenere2018 averaged over k = 0..{found.n_steps - 1}, {counted}; {noise}"
    return [DIVERGENCE, averaged, *in_columns(rows, indent=INDENT)]


def _parts(each: MethodMismatch, *, show_scale: bool) -> tuple[str, str, str]:
    """Return the cells of one method: covariance part, mean part, and mean part at the configured noise."""
    divergence, scale = each.divergence, each.noise.scale
    if isinstance(divergence, str):
        return f"not available: {divergence}", "", ""
    mean = f"{_spread(divergence.mismatch)} / s^2 + {divergence.noise.mean():.2g}"
    if scale is None:
        return _spread(divergence.covariance), mean, ""
    at_scale = _spread(divergence.at(scale))
    return _spread(divergence.covariance), mean, at_scale + (f" (s = {scale:.3g})" if show_scale else "")


def loop_lines(found: Mismatch) -> list[str]:
    """Return the table of the spectral radii and of the convergence of the gains."""
    rows: list[tuple[str, ...]] = [("", "design model", "plants", "estimator gain")]
    for name, each in found.methods.items():
        model = "not available" if each.model_radius is None else f"{each.model_radius:.4g}"
        plants = _spread(each.plant_radii, digits=4) if len(each.plant_radii) else "not available"
        rows.append((name, model, plants, gain_text(each.gain, found.Ts * found.n_steps, found.time_unit)))
    return [LOOPS, *in_columns(rows, indent=INDENT)]


def gain_text(gain: GainConvergence, end: float, unit: str = "s") -> str:
    """Return the text of the convergence of a gain; `end` is the end of the experiment."""
    if gain.missing:
        return f"not available: {gain.missing}"
    if gain.after is None:
        return f"not converged within {gain.until:g} {unit}"
    if not gain.until:
        return "constant"
    text = f"within {100 * STEADY:g} % after {gain.after:.4g} {unit}"
    if gain.off <= STEADY:
        return text
    return f"{100 * gain.off:{'.0f' if gain.off >= 0.1 else '.2g'}} % off at {end:g} {unit}, {text}"


def warnings(found: Mismatch, baseline: str) -> list[str]:
    """Return warnings: gains that have not converged, unstable loops, comparisons of more than estimators."""
    texts = []
    for name, each in found.methods.items():
        if each.gain.after is None:
            texts.append(f"{name}: the estimator gain does not converge within {each.gain.until:g} {found.time_unit}")
        elif each.gain.off > STEADY:
            off = gain_text(each.gain, found.Ts * found.n_steps, found.time_unit)
            texts.append(f"{name}: the estimator gain has not converged when the experiment ends: {off}")
        model = np.array([] if each.model_radius is None else [each.model_radius])
        for where, radii in (("the design model", model), ("the plants", each.plant_radii)):
            n_bad = int((radii >= 1.0).sum())
            if n_bad:
                share = f", {n_bad} of {len(radii)}" if len(radii) > 1 else ""
                texts.append(f"{name}: the loop with {where} is not stable (spectral radius {radii.max():.6g}{share})")
    for name, keys in found.confounded.items():
        differing = f"{name} differs from {baseline} in the estimator and in {', '.join(keys)}"
        texts.append(f"{differing}: the comparison is not of the estimators alone")
    return texts


def _spread(values: Array, digits: int = 3) -> str:
    """Mean [smallest, largest]; a single value alone."""
    mean = f"{values.mean():.{digits}g}"
    return mean if len(values) == 1 else f"{mean} [{values.min():.{digits}g}, {values.max():.{digits}g}]"


def own_component_lines(config: ExperimentConfig) -> tuple[list[str], bool]:
    """Check the own components of the first point; return lines, and whether a check of class `error` has failed."""
    from rmpc_bench.conformance.kit import check_own_components

    lines: list[str] = []
    failed = False
    for each in check_own_components(config.experiment):
        if each.report is None:
            lines.append(f"    {each.method}: {each.text}: not checked: {each.reason}")
            continue
        failed |= not each.report.passed
        where = f" ({each.reason})" if each.reason else ""
        lines.append(f"    {each.method}: {each.text}: {each.report.summary()}{where}")
        for result in each.report.results:
            if result.status in ("failed", "expected"):
                word = result.severity if result.status == "failed" else "expected"
                lines += [f"      {line}" for line in wrap(f"{word} {result.id}: {result.reason}", WIDTH)]
    return (["", TITLE, *lines] if lines else []), failed


def measured_lines(path: Path, config: ExperimentConfig, allow_code: Sequence[Path], shards: int | None) -> list[str]:
    """Measure an experiment and return the lines on time, memory and shards."""
    try:
        found = measure(path, allow_code, imported)
    except PilotError as error:
        return [f"  measured      nothing: the first runs could not be computed ({error})"]
    workers = config.execution.workers
    parts = f"{found.start:.1f} s start, {found.n_runs * found.per_run:.1f} s runs, {found.report:.1f} s report"
    lines = [
        f"  measured      about {_duration(found.total)} of CPU time, from {found.n_pilot} runs: {parts}",
        f"                about {_duration(found.elapsed(workers))} on {workers} processes with a core each",
        f"                about {found.megabytes:.0f} MB of memory in the process that writes the report",
    ]
    if shards is not None:
        each = found.of_shard(shards)
        limit = MINUTE * math.ceil((RESERVE * each + MINUTE) / MINUTE)
        lines += [
            f"  shards        {shards}, each of at most {runs_of_shard(found.n_runs, shards)} runs: "
            f"about {_duration(each)} of CPU time on one process",
            f"                time limit for a batch script: {clock(limit)} ({RESERVE:g} times this, and a minute)",
        ]
    return lines


def _duration(seconds: float) -> str:
    """Write a time with two digits."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.2g} s" if seconds < 100 else f"{seconds:.0f} s"
    minutes = seconds / MINUTE
    return f"{minutes:.0f} min" if minutes < 2 * MINUTE else f"{minutes / MINUTE:.1f} h"


def clock(seconds: float) -> str:
    """Write a time as a batch scheduler takes it.

    >>> clock(5400), clock(360_000)
    ('01:30:00', '100:00:00')
    """
    minutes = round(seconds / MINUTE)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:00"
