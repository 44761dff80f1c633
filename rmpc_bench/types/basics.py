"""What all components have in common: arrays and numbers as annotations, attributes with defaults, designs.

The constraints are annotations of annotated-types, a dependency of pydantic, which validates them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from copy import copy
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from annotated_types import Ge, Gt, Le, Len

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
Text: TypeAlias = Annotated[str, Len(1)]
MAX_STEPS = 1_000_000
"""Largest number of control periods; arrays of a longer run would not fit into memory."""
Steps: TypeAlias = Annotated[int, Ge(1), Le(MAX_STEPS)]
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


if TYPE_CHECKING:
    attribute = property
else:

    class attribute:
        """Attribute of a base class; the decorated function computes its default from the instance.

        A subclass replaces it by a class attribute, a property, a dataclass field or an assignment in `__init__`.

        Examples
        --------
        >>> class Shape:
        ...     @attribute
        ...     def sides(self):
        ...         return 0
        >>> class Square(Shape):
        ...     sides = 4
        >>> Shape().sides, Square().sides
        (0, 4)
        """

        def __init__(self, default: Callable[[Any], Any]) -> None:
            self.default, self.__doc__ = default, default.__doc__

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            """Compute the default of an instance; a class has none."""
            if instance is None:
                # `dataclass` takes what it finds on the class for the default of a field of the same name.
                raise AttributeError(f"{self.default.__name__!r} is an attribute of instances")
            return self.default(instance)


class Design:
    """A frozen object that is made once, before any run, and shared by all runs and workers."""

    @attribute
    def remarks(self) -> tuple[str, ...]:
        """Sentences for the user about this design; `check` prints them."""
        return ()

    @attribute
    def deterministic(self) -> bool:
        """Whether the same run gives the same numbers every time; otherwise equal methods share no trials."""
        return True

    @attribute
    def cost_per_step(self) -> float:
        """Time of a step per run in a block of 50 runs [s]; 0 where it is a few microseconds at most."""
        return 0.0

    @attribute
    def expected_failures(self) -> Mapping[str, str]:
        """Checks of `rmpc_bench.conformance` that the component is meant to fail -> reason; reports print them."""
        return {}

    @attribute
    def holds(self) -> bool:
        """Whether a failed step of a run is held and counted, so that the run goes on."""
        return False

    def warm_up(self) -> None:
        """Do costly work that workers share, such as compiling; doing it again costs nothing."""


class Keyword(NamedTuple):
    """A keyword that several design functions have."""

    annotation: Any
    default: Any  # `inspect.Parameter.empty` where it must be given
    meaning: str


DesignFunction = TypeVar("DesignFunction", bound=Callable[..., Any])


def takes(keywords: Mapping[str, Keyword], last: bool = True) -> Callable[[DesignFunction], DesignFunction]:
    """Replace ``**NAME`` of a design function by keywords, `last` or before its own, and `NAME` in its docstring.

    The signature defines the keys of a configuration.
    """

    def taking(design: DesignFunction) -> DesignFunction:
        signature = inspect.signature(design)
        *own, gathered = signature.parameters.values()
        listed = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=each.default, annotation=each.annotation)
            for name, each in keywords.items()
        ]
        place = len(own) if last else sum(each.kind == each.POSITIONAL_OR_KEYWORD for each in own)
        vars(design)["__signature__"] = signature.replace(parameters=[*own[:place], *listed, *own[place:]])
        lines = "\n".join(f"{name} : {each.meaning}" for name, each in keywords.items())
        doc = inspect.getdoc(design) or ""
        design.__doc__ = re.sub(rf"^{gathered.name} : .*", lambda _: lines, doc, flags=re.MULTILINE)
        return design

    return taking


def values_of(keywords: Mapping[str, Keyword], given: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers that a design function has been given, with the defaults of the others."""
    if unknown := {*given} - {*keywords}:
        raise TypeError(f"unknown keywords: {', '.join(sorted(unknown))}")
    return {name: float(given.get(name, each.default)) for name, each in keywords.items()}


def declaring(design: Any, **values: Any) -> Any:
    """Return a copy of a design with other values of attributes that its class does not compute."""
    made = copy(design)
    made.__dict__.update(values)
    return made
