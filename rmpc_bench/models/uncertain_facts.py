"""Analysis of an uncertain linear system before any run: sizes, stability and zeros, as text.

Robust stability refers to the state equation x(k+1) = (A + H_A F_x G_x) x.  For every F_x with F_x' F_x <= I it is
decided by the H-infinity norm of the loop, for a white F_x by the second moments of x.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.matrix_sizes import NOUNS
from rmpc_bench.models.uncertain_system import CHANNELS, Matrices, UncertainSystem
from rmpc_bench.numerics.invariant_zeros import zeros
from rmpc_bench.numerics.stability import INSIDE, hinf_peak, mean_square_radius, spectral_radius
from rmpc_bench.types import Array

Fact = tuple[str, str]
ON_CIRCLE = 1e-6
"""Distance of a zero from the unit circle that counts as rounding; a zero of multiplicity d is accurate to about
1e-16^(1/d)."""
ENTRANCES = {"nu": {"B"}, "nw": {"Bw", "Dw", "w"}, "nv": {"Bv", "Dv", "v"}}
"""Size of a signal -> the matrices and channels through which that signal enters."""


def facts(system: UncertainSystem, law: Mapping[str, tuple[float, float]] | None = None) -> list[Fact]:
    """Describe a system: pairs of a label and a text of one or more lines.

    Parameters
    ----------
    system : the system; a system that varies is evaluated at k = 0
    law : channel (``x``, ``w``, ``v``) -> mean and variance of the entries of its F, if F is white
    """
    m = system.at(0)
    known = [("sizes", _sizes(system)), *_matrices(system)]
    if system.varies:
        known += [("at k = 0", "the following results refer to the matrices at k = 0")]
    known += [("spectral radius of A", _radius(m.A))]
    if "x" in system.active:
        known += [("uncertain loop", _loop(m))]
        if law is not None and "x" in law:
            known += [("mean square", _mean_square(m, *law["x"]))]
    if {"Bw", "Dw"} & system.active:
        known += [("zeros from w to y", _zeros(m))]
    return known


def _sizes(system: UncertainSystem) -> str:
    counts = []
    for size, noun in NOUNS.items():
        n = system.size(size)
        idle = size in ENTRANCES and not ENTRANCES[size] & system.active
        counts += [f"{size} = {n} {noun}{'s' * (n > 1)}{' (without effect)' if idle else ''}"]
    shapes = [
        f"F_{name} is {system.size('r' + name)} x {system.size('s' + name)}"
        for name in CHANNELS
        if name in system.active
    ]
    return "\n".join([", ".join(counts[:3]), ", ".join(counts[3:]), ", ".join(shapes) or "no uncertainty"])


def _matrices(system: UncertainSystem) -> list[Fact]:
    """List the matrices that are not zero, and the names of those that are."""
    shown, absent = [], []
    for name, matrix in zip(Matrices._fields, system.over_time, strict=True):
        if matrix.any():
            note = "varies with k; at k = 0\n" if len(matrix) > 1 else ""
            shown += [(name, note + _rows(matrix[0]))]
        else:
            absent += [name]
    return shown + ([("zero", ", ".join(absent))] if absent else [])


def _rows(matrix: Float[Array, "rows columns"]) -> str:
    """Write a matrix with aligned columns."""
    texts = [[_number(value) for value in row] for row in matrix]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    return "\n".join("  ".join(f"{text:>{width}}" for text, width in zip(row, widths, strict=True)) for row in texts)


def _number(value: float) -> str:
    # Adding 0 turns -0 into 0.
    return f"{value + 0.0:.6g}"


def _radius(A: Float[Array, "n n"]) -> str:
    radius = spectral_radius(A)
    return f"{_number(radius)}: {'stable' if radius < INSIDE else 'not stable'} without uncertainty"


def _loop(m: Matrices) -> str:
    """State whether the system is quadratically stable for all F_x."""
    peak = hinf_peak(m.A, m.H_A, m.G_x)
    norm = "infinite" if peak.norm == inf else _number(peak.norm)
    where = "" if np.isnan(peak.angle) else f", reached at {_number(peak.angle)} rad per step"
    lines = [f"H-infinity norm of G_x (zI - A)^-1 H_A: {norm}{where}"]
    if spectral_radius(m.A) >= INSIDE:
        return "\n".join([*lines, "quadratically stable: no, not even without uncertainty"])
    answer = "yes" if peak.norm < INSIDE else "no"
    reach = f"by less than {_number(1.0 / peak.norm)}" if peak.norm > 0.0 else "by any factor"
    return "\n".join([*lines, f"quadratically stable: {answer}; stable if F_x is scaled {reach}"])


def _mean_square(m: Matrices, mean: float, variance: float) -> str:
    """State whether the second moments of the state converge under a white F_x."""
    radius = mean_square_radius(m.A, m.H_A, m.G_x, mean, variance)
    answer = "the second moments of x converge" if radius < INSIDE else "the second moments of x do not converge"
    law = f"white F_x, entries of mean {_number(mean)} and variance {_number(variance)}"
    return f"radius {_number(radius)}: {answer}\n{law}"


def _zeros(m: Matrices) -> str:
    """List the zeros, and explain the effect of those on the unit circle."""
    found = zeros(m.A, m.Bw, m.C, m.Dw)
    upper = found[found.imag >= 0.0]
    circle = np.abs(np.abs(upper) - 1.0) < ON_CIRCLE
    order = np.lexsort((upper.imag, upper.real))
    lines = [_zero(upper[i]) + (" (on the unit circle)" if circle[i] else "") for i in order]
    meaning = (
        "zeros on the unit circle: a predictor designed without measurement noise has no stable limit,\n"
        "and with little measurement noise its Riccati recursion converges slowly"
    )
    return (", ".join(lines) or "none") + (f"\n{meaning}" if circle.any() else "")


def _zero(z: complex) -> str:
    # Zeros of interest have a modulus near 1, so that a real part of 1e-16 is rounding.
    real = _number(round(z.real, 12))
    return f"{real} +- {_number(z.imag)}j" if z.imag else real
