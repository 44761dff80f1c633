"""Arrays and numbers as annotations.

The constraints are annotations of annotated-types, a dependency of pydantic, which validates them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Protocol, TypeAlias

import numpy as np
from annotated_types import Ge, Gt, Le

# Not `NDArray`: since NumPy 2.5 it is a type alias object, which jaxtyping refuses.
Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[Any]]
Matrix: TypeAlias = float | list[float] | list[list[float]]
"""A number (times the identity), a list (the diagonal) or a matrix."""


class OverTime:
    """Mark of an annotation: numbers that may depend on the time index k."""


class OfTime(Protocol):
    """A number that depends on time."""

    def __call__(self, values: Mapping[str, float], /) -> float:
        """Value at ``{"k": k}``; ValueError where there is none."""


SystemMatrix: TypeAlias = Annotated[Any, OverTime()]
"""None (zero), a number (times the identity) or a list of rows, of numbers or `OfTime`; a list is the diagonal
of a matrix that is square by its meaning, and refused for any other."""

Positive: TypeAlias = Annotated[float, Gt(0)]
NonNegative: TypeAlias = Annotated[float, Ge(0)]
Count: TypeAlias = Annotated[int, Ge(1)]
Horizon: TypeAlias = Annotated[int, Ge(1), Le(1000)]
"""Samples ahead; the matrices of a prediction grow with its square."""


class FromCode:
    """Mark of an annotation: the key names something in a Python file of the user, ``PATH.py:NAME``."""


class FromCodeOrText(FromCode):
    """Mark of an annotation: the key names something in a Python file of the user, or is another text."""


class FromData:
    """Mark of an annotation: the key names data files by a path or a pattern, relative to the file it stands in."""


UserFunction: TypeAlias = Annotated[Any, FromCode()]
"""A function or class of a user's file; the design function receives the loaded object."""
UserFunctionOrText: TypeAlias = Annotated[Any, FromCodeOrText()]
"""The same, or a text that does not have the form ``PATH.py:NAME``, such as the name of something installed."""
DataFiles: TypeAlias = Annotated[Any, FromData()]
"""Data files; the design function receives a sorted tuple of absolute paths (`pathlib.Path`)."""
