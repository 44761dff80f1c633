"""Delays that a design model knows: its key `delay`, and the delays of a method that come from it.

Model   The plant acts on u(k) = u_c(k - d) of its input, and y(k) arrives later; both delays are laws of `noise`.  What
        the methods know of them is `delay`: `same` as in the noise, `none`, or whole numbers of samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le, Len
from pydantic import BeforeValidator

from rmpc_bench.types import DesignError, KnownDelay
from rmpc_bench.types.errors import unknown

MOST = 100
"""Longest delay [samples]."""
SAME, NONE = "same", "none"


def _refuse_word(value: Any) -> Any:
    if value in (SAME, NONE):
        raise ValueError(f"must be a whole number of samples (got {value!r}); `delay: {value}` stands for all delays")
    return value


Samples = Annotated[int, Ge(0), Le(MOST), BeforeValidator(_refuse_word)]


@dataclass(frozen=True)
class Delay:
    """Delays that the design model has, in samples.

    Parameters
    ----------
    input : delay of the input
    measurement : delay of all outputs, name of an output -> its delay, or `same` as in the noise
    """

    input: Samples = 0
    measurement: Samples | Literal["same"] | Annotated[dict[str, Samples], Len(1)] = 0


def _refuse_number(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError(f"say input or measurement: {{input: {value:g}}} or {{measurement: {value:g}}}")
    if value == {}:
        raise ValueError("say input or measurement, such as {input: 1}")
    return value


DelayKey: Any = Annotated[Literal["same", "none"] | Delay, BeforeValidator(_refuse_number)]
"""Value of the key `delay` of a design model."""


def known_delay(given: str | Delay, of_input: int | str, outputs: Sequence[str]) -> KnownDelay:
    """Return the delays that the key gives; `of_input` is that of the noise, in words where it is not one number."""
    if given == NONE:
        return KnownDelay(0, (0,) * len(outputs))
    if isinstance(given, Delay):
        return KnownDelay(given.input, _of_outputs(given.measurement, outputs))
    if isinstance(of_input, str):
        number = "say which number the design model assumes, delay: {input: 1}"
        raise DesignError(f"the delay of the input is {of_input}: {number}", "delay")
    return KnownDelay(of_input, None)


def _of_outputs(given: int | str | Mapping[str, int], outputs: Sequence[str]) -> tuple[int, ...] | None:
    """Return the delay of every output; None for `same`."""
    if isinstance(given, int):
        return (given,) * len(outputs)
    if isinstance(given, str):
        return None
    for name in given:
        if name not in outputs:
            raise DesignError(unknown(name, outputs, "output"), f'delay.measurement."{name}"')
    return tuple(given.get(name, 0) for name in outputs)
