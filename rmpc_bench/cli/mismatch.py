"""What `check --deep` prints: tables of every point, warnings, and at the end what the tables mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.diagnostics.mismatch import STEADY, DeepFinding, Gain, MethodFinding, look_deep
from rmpc_bench.simulation.threads import single_thread

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.types import Array

MOST_POINTS = 12
"""Points of a sweep that are looked at."""
DIVERGENCE = "  divergence of the plant from the model, which suggests c"
LOOPS = "  linear loop: spectral radius at the last gains, without friction and limits, and when the gain is steady"
CAPTION = (
    "  s: standard deviation of the noise over the model's",
    "  No gain depends on s, and the mean part diverges as s -> 0.  Friction and limits, which make the true",
    "  density non-normal, are left out; states that the model lacks are marginalised; the plant's process noise",
    "  is the model's.  With `kl: printed`, c stands for twice (10).",
)
NOISE = {
    "measurement": "s of the measurement noise",
    "process": "s of the process noise",
    "none": "no noise, so s = 0",
    "unknown": "s not known for this law of noise",
}


def deep_lines(config: ExperimentConfig) -> list[str]:
    """Return the lines of every point of a sweep, each under its name, and the caption."""
    lines: list[str] = []
    known: dict[str, Gain] = {}
    explained = False
    with single_thread():
        for point in config.points[:MOST_POINTS]:
            found = look_deep(point, config.baseline, known)
            explained |= found.n_plants > 0
            lines += ["", f"  {point.title}"] if point.title else []
            lines += ["", *divergence_lines(found), "", *loop_lines(found)]
            lines += [f"  warning: {text}" for text in warnings(found, config.baseline)]
    left = len(config.points) - MOST_POINTS
    lines += ["", f"  and {left} more points, not looked at"] if left > 0 else []
    return lines + (["", *CAPTION] if explained else [])


def divergence_lines(found: DeepFinding) -> list[str]:
    """Lay out the tolerance c that the plants suggest, beside the configured one.

    Parameters
    ----------
    found : what `look_deep` has found at a point
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


def _parts(each: MethodFinding, *, show_scale: bool) -> tuple[str, str, str]:
    """Cells of one method: the two parts, and the second one at the configured noise."""
    divergence, scale = each.divergence, each.noise.scale
    if isinstance(divergence, str):
        return f"not available: {divergence}", "", ""
    mean = f"{_spread(divergence.mismatch)} / s^2 + {divergence.noise.mean():.2g}"
    if scale is None:
        return _spread(divergence.covariance), mean, ""
    at_scale = _spread(divergence.at(scale))
    return _spread(divergence.covariance), mean, at_scale + (f" (s = {scale:.3g})" if show_scale else "")


def loop_lines(found: DeepFinding) -> list[str]:
    """Lay out the poles and the convergence of the gains.

    Parameters
    ----------
    found : what `look_deep` has found at a point
    """
    rows: list[tuple[str, ...]] = [("", "model", "plants", "estimator gain")]
    for name, each in found.methods.items():
        model = "not available" if each.model_radius is None else f"{each.model_radius:.4g}"
        plants = _spread(each.plant_radii, digits=4) if len(each.plant_radii) else "not available"
        rows.append((name, model, plants, gain_text(each.gain, found.Ts * found.n_steps)))
    return [LOOPS, *_table(rows)]


def gain_text(gain: Gain, end: float) -> str:
    """Say when a gain is steady.

    Parameters
    ----------
    gain : how it converges
    end : of the experiment [s]
    """
    if gain.missing:
        return f"not available: {gain.missing}"
    if gain.after is None:
        return f"not steady within {gain.until:g} s"
    if not gain.until:
        return "constant"
    text = f"within {100 * STEADY:g} % after {gain.after:.4g} s"
    if gain.off <= STEADY:
        return text
    return f"{100 * gain.off:{'.0f' if gain.off >= 0.1 else '.2g'}} % off at {end:g} s, {text}"


def warnings(found: DeepFinding, baseline: str) -> list[str]:
    """Say where the comparison stands on weak ground.

    Parameters
    ----------
    found : what `look_deep` has found at a point
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
        for where, radii in (("the model", model), ("the plants", each.plant_radii)):
            n_bad = int((radii >= 1.0).sum())
            if n_bad:
                share = f", {n_bad} of {len(radii)}" if len(radii) > 1 else ""
                texts.append(f"{name}: the loop with {where} does not decay (radius {radii.max():.6g}{share})")
    for name, keys in found.confounded.items():
        differing = f"{name} differs from {baseline} in the estimator and in {', '.join(keys)}"
        texts.append(f"{differing}: their comparison is not one of estimators alone")
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
