"""Output of `check --deep`: tables and warnings of every point, then the meaning of the tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.config_file.component import build_component
from rmpc_bench.config_file.tree import kind_of
from rmpc_bench.diagnostics.mismatch import STEADY, GainConvergence, MethodMismatch, Mismatch, model_mismatch
from rmpc_bench.simulation.threads import single_thread

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.types import Array

MAX_POINTS = 12
"""Points of a sweep that are analysed, the first ones."""
DIVERGENCE = "  divergence of the plant from the design model, a guide for the tolerance c"
LOOPS = "  linear closed loop without friction and limits: spectral radius at the last gains, convergence of the gain"
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
    """Return the table of the divergence of the plants, with the configured tolerance c.

    Parameters
    ----------
    found : the mismatch at a point
    """
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
    return [DIVERGENCE, averaged, *_table(rows)]


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
    """Return the table of the spectral radii and of the convergence of the gains.

    Parameters
    ----------
    found : the mismatch at a point
    """
    rows: list[tuple[str, ...]] = [("", "design model", "plants", "estimator gain")]
    for name, each in found.methods.items():
        model = "not available" if each.model_radius is None else f"{each.model_radius:.4g}"
        plants = _spread(each.plant_radii, digits=4) if len(each.plant_radii) else "not available"
        rows.append((name, model, plants, gain_text(each.gain, found.Ts * found.n_steps)))
    return [LOOPS, *_table(rows)]


def gain_text(gain: GainConvergence, end: float) -> str:
    """Return the text of the convergence of a gain.

    Parameters
    ----------
    gain : its convergence
    end : end of the experiment [s]
    """
    if gain.missing:
        return f"not available: {gain.missing}"
    if gain.after is None:
        return f"not converged within {gain.until:g} s"
    if not gain.until:
        return "constant"
    text = f"within {100 * STEADY:g} % after {gain.after:.4g} s"
    if gain.off <= STEADY:
        return text
    return f"{100 * gain.off:{'.0f' if gain.off >= 0.1 else '.2g'}} % off at {end:g} s, {text}"


def warnings(found: Mismatch, baseline: str) -> list[str]:
    """Return warnings: gains that have not converged, unstable loops, comparisons of more than estimators.

    Parameters
    ----------
    found : the mismatch at a point
    baseline : name of the method that the others are compared with
    """
    texts = []
    for name, each in found.methods.items():
        if each.gain.after is None:
            texts.append(f"{name}: the estimator gain does not converge within {each.gain.until:g} s")
        elif each.gain.off > STEADY:
            off = gain_text(each.gain, found.Ts * found.n_steps)
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


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [2 + max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "    " + "".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
