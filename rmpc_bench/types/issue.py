"""An issue of a component's parameters, found before any run, and messages that several components share."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from rmpc_bench.types.errors import DesignError

OTHER_NAMES: Mapping[str, str] = {
    "normal": "gaussian",
    "w": "process",
    "v": "measurement",
    "sigma": "std",
    "stddev": "std",
    "var": "cov",
    "variance": "cov",
    "kf": "kalman",
}
"""Names that other programs and papers use -> the name here."""


class Issue(NamedTuple):
    """One thing wrong with the parameters of a component."""

    key: str
    """The YAML key to blame, with dots inside a nested one; empty for the component as a whole."""
    message: str


def issues_of(function: Callable[..., Any], *arguments: Any) -> Iterator[Issue]:
    """Call a function and yield the `DesignError` that it raises as an issue; its result is dropped."""
    try:
        function(*arguments)
    except DesignError as error:
        yield Issue(error.parameter, str(error))


def no_such_component(noun: str, index: int, n: int) -> str:
    """Say that an index counts beyond the components there are: ``there is no state 3 (they count from 0 to 1)``."""
    return f"there is no {noun} {index} (they count from 0 to {n - 1})"


def does_not_fit(shape: tuple[int, ...], expected: tuple[int, int]) -> str:
    """Say that a matrix has the wrong shape, with both shapes, and whether its transpose would fit.

    Examples
    --------
    >>> does_not_fit((1, 2), (2, 1))
    'shape (1, 2) does not fit: 2 x 1 numbers are required, as in its transpose'
    """
    turned = ", as in its transpose" if shape == expected[::-1] and shape != expected else ""
    return f"shape {shape} does not fit: {expected[0]} x {expected[1]} numbers are required{turned}"


def unknown(name: str, known: Iterable[str], noun: str, way_out: str = "") -> str:
    """Say that a name is unknown, and give the nearest known one, or else all known ones.

    Parameters
    ----------
    name : the unknown name
    known : the names there are
    noun : what they are names of
    way_out : command that lists them
    """
    known = list(known)
    near = nearest(name, known)
    hint = f"; did you mean {near!r}?" if near else f"; known: {', '.join(known) or 'none'}"
    return f"{name!r} is not a known {noun}{hint}" + (f" ({way_out})" if way_out else "")


def nearest(name: str, known: Sequence[str]) -> str | None:
    """Return the known name that an unknown one probably means; None where none is near.

    Examples
    --------
    >>> nearest("tank.py", ["pi.py", "tanks.py"])
    'tanks.py'
    """
    # A name in the wrong case is nearest to the same name in the right one.
    near = [each for each in known if each.lower() == name.lower()]
    near = near or [each for each in known if each == OTHER_NAMES.get(name.lower())]
    # One of two letters is enough in a short name, such as `Hp`; `corners` is not near to `none`.
    cutoff = 0.5 if len(name) < 4 else 0.55
    return next(iter(near or difflib.get_close_matches(name, known, n=1, cutoff=cutoff)), None)


def row_by_row(values: Sequence[Any], meaning: Callable[[int, int], str] | None = None) -> str:
    """Say that a matrix is written row by row, with the two matrices that a flat list could mean.

    Parameters
    ----------
    values : the list
    meaning : says what the rows and columns of a shape stand for; only the shape is shown without it

    Examples
    --------
    >>> row_by_row([1, 0])
    'write it row by row: [[1, 0]] is 1 x 2, [[1], [0]] is 2 x 1'
    """
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    n = len(texts)
    readings = {(1, n): f"[[{', '.join(texts)}]]", (n, 1): f"[{', '.join(f'[{text}]' for text in texts)}]"}
    words = [
        f"{text} is {rows} x {columns}" + (f" ({meaning(rows, columns)})" if meaning else "")
        for (rows, columns), text in readings.items()
    ]
    return f"write it row by row: {', '.join(words)}"
