"""Matrices of an uncertain linear system, and their sizes.

System  x(k+1) = (A + H_A F_x G_x) x + B u + (Bw + H_Bw F_w G_w) w + (Bv + H_Bv F_v G_v) v,
        y(k)   = (C + H_C F_x G_x) x + D u + (Dw + H_Dw F_w G_w) w + (Dv + H_Dv F_v G_v) v,
        F_x' F_x <= I, F_w' F_w <= I, F_v' F_v <= I; otherwise every F(k) is arbitrary and may vary with k.
Source  souto2011, (24), (25), (34)-(38), with an input u.
Form    Matrices with separate uncertainties, (26)-(31), share an F with more columns here: H_A = [h 0], H_C = [0 h'].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from inspect import Parameter
from math import inf
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.matrix_sizes import NOUNS, expanded, sizes_of
from rmpc_bench.numerics.linalg import at_sample
from rmpc_bench.numerics.stability import INSIDE, hinf_peak, mean_square_radius, spectral_radius, zeros
from rmpc_bench.types import Array, DesignError, SystemMatrix
from rmpc_bench.types.basics import Keyword, takes


class Matrices(NamedTuple):
    """All matrices at one k, or with axis 0 = k of length 1 or N + 1."""

    A: Float[Array, "*k nx nx"]
    B: Float[Array, "*k nx nu"]
    Bw: Float[Array, "*k nx nw"]
    Bv: Float[Array, "*k nx nv"]
    C: Float[Array, "*k ny nx"]
    Dw: Float[Array, "*k ny nw"]
    Dv: Float[Array, "*k ny nv"]
    H_A: Float[Array, "*k nx rx"]
    H_C: Float[Array, "*k ny rx"]
    G_x: Float[Array, "*k sx nx"]
    H_Bw: Float[Array, "*k nx rw"]
    H_Dw: Float[Array, "*k ny rw"]
    G_w: Float[Array, "*k sw nw"]
    H_Bv: Float[Array, "*k nx rv"]
    H_Dv: Float[Array, "*k ny rv"]
    G_v: Float[Array, "*k sv nv"]
    D: Float[Array, "*k ny nu"]


TABLE: Mapping[str, tuple[str, str, str]] = {
    "A": ("nx", "nx", "state matrix"), "B": ("nx", "nu", "input matrix"), "C": ("ny", "nx", "output matrix"),
    "Bw": ("nx", "nw", "how the process noise w enters the state"),
    "Bv": ("nx", "nv", "how the measurement noise v enters the state"),
    "Dw": ("ny", "nw", "how w enters the output"), "Dv": ("ny", "nv", "how v enters the output"),
    "H_A": ("nx", "rx", "how F_x enters A"), "H_C": ("ny", "rx", "how F_x enters C"),
    "G_x": ("sx", "nx", "combination of the states that F_x multiplies"),
    "H_Bw": ("nx", "rw", "how F_w enters Bw"), "H_Dw": ("ny", "rw", "how F_w enters Dw"),
    "G_w": ("sw", "nw", "combination of w that F_w multiplies"),
    "H_Bv": ("nx", "rv", "how F_v enters Bv"), "H_Dv": ("ny", "rv", "how F_v enters Dv"),
    "G_v": ("sv", "nv", "combination of v that F_v multiplies"),
    "D": ("ny", "nu", "feedthrough: how u(k) enters y(k)"),
}  # fmt: skip
"""Matrix -> number of its rows and of its columns (states, inputs, outputs, noises, those of the F), and meaning."""
SIZES: Mapping[str, tuple[str, str]] = {name: TABLE[name][:2] for name in Matrices._fields}
REQUIRED = ("A", "C")

CHANNELS: Mapping[str, tuple[str, str, str]] = {
    "x": ("H_A", "H_C", "G_x"),
    "w": ("H_Bw", "H_Dw", "G_w"),
    "v": ("H_Bv", "H_Dv", "G_v"),
}
"""Name of an F -> its factors in x(k+1), in y(k), and the one on its right."""


@dataclass(frozen=True, eq=False)
class UncertainSystem:
    """An uncertain linear system; `over_time` has axis 0 = k, of length 1 if the matrix is constant."""

    over_time: Matrices

    def at(self, k: int) -> Matrices:
        """Return the matrices at k."""
        return self._always if self._always is not None else Matrices(*(at_sample(M, k) for M in self.over_time))

    @cached_property
    def _always(self) -> Matrices | None:
        constant = all(len(M) == 1 for M in self.over_time)
        return Matrices(*(M[0] for M in self.over_time)) if constant else None

    @property
    def varies(self) -> bool:
        """Whether any matrix depends on k."""
        return self._always is None

    def size(self, name: str) -> int:
        """Return the number that a name of `SIZES` stands for, such as ``nx``."""
        matrix, axis = next((matrix, sizes.index(name)) for matrix, sizes in SIZES.items() if name in sizes)
        return int(getattr(self.over_time, matrix).shape[1 + axis])

    @cached_property
    def active(self) -> frozenset[str]:
        """Names of the matrices that are not zero, and of the channels whose F has an effect."""
        matrices = {name for name, M in self.over_time._asdict().items() if M.any()}
        channels = {name for name, (H, H_out, G) in CHANNELS.items() if G in matrices and {H, H_out} & matrices}
        return frozenset(matrices | channels)

    def scaled(self, factor: float) -> UncertainSystem:
        """Return the system with all uncertainty times a factor."""
        new = {name: factor * getattr(self.over_time, name) for names in CHANNELS.values() for name in names[:2]}
        return UncertainSystem(self.over_time._replace(**new))


class OfSystem:
    """Sizes of a plant or a design model with the matrices of a system."""

    system: UncertainSystem

    nx = property(lambda self: self.system.size("nx"))
    nu = property(lambda self: self.system.size("nu"))
    ny = property(lambda self: self.system.size("ny"))


takes_matrices = takes(
    {
        name: Keyword(SystemMatrix, Parameter.empty if name in REQUIRED else None, f"({rows}, {columns}) {meaning}")
        for name, (rows, columns, meaning) in TABLE.items()
    },
    last=False,
)
"""Replaces ``**matrices`` of a design function by one keyword per matrix."""


def uncertain_system(n_steps: int, given: Mapping[str, SystemMatrix]) -> UncertainSystem:
    """Read the matrices of a system by the names of `SIZES`, at k = 0..N, and complete the missing ones with zeros.

    A matrix is None (zero), a number (times the identity), a list of rows, or an array (k, rows, columns); A may be a
    list, its diagonal.  Entries may be functions of ``{"k": k}``.  A DesignError says what is missing or does not fit.
    """
    for name in sorted({*given} - {*SIZES}):
        raise DesignError(f"{name!r} is not a matrix of an uncertain system; choose from {', '.join(SIZES)}", name)
    for name in REQUIRED:
        if given.get(name) is None:
            raise DesignError(f"the matrix {name} is missing", name)
    read = {name: _read(name, value, n_steps) for name, value in given.items() if value is not None}
    sizes = sizes_of(read, SIZES)
    full: dict[str, Array] = {}
    for name, (rows, columns) in SIZES.items():
        shape = (sizes[rows], sizes[columns])
        matrix = read.get(name)
        full[name] = np.zeros((1, *shape)) if matrix is None else expanded(name, matrix, shape)
    for H, H_out, G in CHANNELS.values():
        if G not in read and any(name in read and full[name].any() for name in (H, H_out)):
            raise DesignError(f"{H} and {H_out} need {G}: the uncertainty is {H} F {G}", H if H in read else H_out)
    return UncertainSystem(Matrices(**full))


def _read(name: str, value: Any, n_steps: int) -> Array:
    """Return an array (k,) of numbers, (k, n) of diagonals or (k, rows, columns) of matrices."""
    entries = entries_of(name, value)
    if entries.ndim == 3:
        if len(entries) not in (1, n_steps + 1):
            raise DesignError(f"has {len(entries)} entries over k; 1 or {n_steps + 1} are required", name)
        return entries
    found = [values_at(name, entries, k) for k in range(n_steps + 1 if depends_on_k(entries) else 1)]
    return np.array(found)


def entries_of(name: str, value: Any) -> Array:
    """Return the entries of a short form or of a list of rows, numbers or functions of ``{"k": k}``, as objects.

    An array (k, rows, columns) stays one of numbers.
    """
    if isinstance(value, np.ndarray) and value.ndim == 3:
        return np.array(value, dtype=float)
    entries = np.array(value, dtype=object)
    if entries.ndim > 2 or any(isinstance(entry, list) for entry in entries.flat):
        raise DesignError("must be a number or a list of rows of the same length", name)
    return entries


def depends_on_k(entries: Array) -> bool:
    """Whether any entry is a function of k."""
    return any(callable(entry) for entry in entries.flat)


def values_at(name: str, entries: Array, k: int) -> Array:
    """Return the numbers that entries stand for at k."""
    try:
        values = [entry({"k": k}) if callable(entry) else entry for entry in entries.flat]
    except ValueError as error:
        raise DesignError(f"has no value at k = {k}: {error}", name) from None
    return np.array(values, dtype=float).reshape(entries.shape)


Fact = tuple[str, str]
ON_CIRCLE = 1e-6
"""Distance of a zero from the unit circle that counts as rounding; a zero of multiplicity d is accurate to about
1e-16^(1/d)."""
ENTRANCES = {"nu": {"B", "D"}, "nw": {"Bw", "Dw", "w"}, "nv": {"Bv", "Dv", "v"}}
"""Size of a signal -> the matrices and channels through which that signal enters."""


# Analysis of an uncertain linear system before any run: sizes, stability and zeros, as text.
#
# Robust stability refers to the state equation x(k+1) = (A + H_A F_x G_x) x.  For every F_x with F_x' F_x <= I it is
# decided by the H-infinity norm of the loop, for a white F_x by the second moments of x.


def facts(system: UncertainSystem, law: Mapping[str, tuple[float, float]] | None = None) -> list[Fact]:
    """Describe a system at k = 0 by labels and texts; `law`: channel -> mean and variance of entries of a white F."""
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
        elif name != "D":
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
