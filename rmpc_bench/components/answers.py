"""Checks of the values that methods of single-run components return; messages say what was expected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.types import Array, InvalidReturnValue

_SYMMETRY = 1e-8
"""Largest difference of P from its transpose, relative to its largest entry; rounding leaves about 1e-15."""


def numbers(value: Any, noun: str, shape: tuple[int, ...], owner: str) -> Array:
    """Return an answer as an array of a shape; InvalidReturnValue for another shape or what is no real number."""
    if value is None:
        raise InvalidReturnValue(f"returned nothing; {owner} has {_counted(shape, noun)}")
    try:
        array = np.asarray(value)
    except ValueError:
        raise InvalidReturnValue(f"returned lists of different lengths; {owner} has {_counted(shape, noun)}") from None
    if array.dtype.kind not in "fiu":
        raise InvalidReturnValue(f"returned entries of type {_type_name(array)}; real numbers are expected")
    if array.shape == shape or (array.ndim == 0 and all(n == 1 for n in shape)):
        return array
    raise InvalidReturnValue(f"returned {_given(array)}; {owner} has {_counted(shape, noun)}")


def _type_name(array: Array) -> str:
    if array.dtype == object:
        inner = next((type(each).__name__ for each in array.flat if not isinstance(each, int | float)), "object")
        return inner
    return str(array.dtype)


def _counted(shape: tuple[int, ...], noun: str) -> str:
    n = shape[-1]
    text = f"{n} {noun}{'' if n == 1 else 's'}"
    return text if len(shape) == 1 else f"{text}, so that it is {' x '.join(map(str, shape))}"


def _given(array: Array) -> str:
    if array.ndim == 0:
        return "a number"
    if array.ndim == 1:
        return f"{len(array)} number{'' if len(array) == 1 else 's'}"
    return f"an array of shape {array.shape}"


def finite_rows(values: Array) -> Array:
    """Whether all entries of a row are finite, for every row."""
    return np.asarray(np.isfinite(values).all(axis=tuple(range(1, values.ndim))))


def asymmetric_rows(P: Array) -> Array:
    """Whether the matrix of a row is not symmetric, for every row; NaN counts as symmetric."""
    scale = np.abs(P).max(axis=(1, 2), initial=0.0)
    return np.asarray(np.abs(P - P.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0) > _SYMMETRY * scale)


class Reports:
    """Entries of given shapes that a component reports besides its main answer, one array per entry and sample."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.shapes = shapes

    def empty(self, n_runs: int) -> dict[str, Array]:
        """Return arrays of NaN, which stand for an entry that a run does not report."""
        return {name: np.full((n_runs, *shape), np.nan) for name, shape in self.shapes.items()}

    def keep(self, row: int, given: Any, info: Mapping[str, Array]) -> None:
        """Copy what one run reports; InvalidReturnValue for an entry that is not declared or has another shape."""
        if not isinstance(given, Mapping):
            found = type(given).__name__
            raise InvalidReturnValue(f"returned a {found} as its last entry; a mapping name -> number is expected")
        for name, value in given.items():
            if name not in self.shapes:
                known = ", ".join(self.shapes) or "nothing"
                raise InvalidReturnValue(f"reports {name!r}, which `reports` of the class does not name ({known})")
            array = np.asarray(value)
            if array.dtype.kind not in "fiub" or array.shape != self.shapes[name]:
                raise InvalidReturnValue(
                    f"reports {name!r} with shape {array.shape}; `reports` names {self.shapes[name]}"
                )
            info[name][row] = array


def reports_of(declared: Any) -> dict[str, tuple[int, ...]]:
    """Return the declared entries of a class with their shapes; a list of names stands for single numbers."""
    shapes = declared if isinstance(declared, Mapping) else dict.fromkeys(declared, ())
    return {name: tuple(shape) for name, shape in shapes.items()}
