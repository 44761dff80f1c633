"""Standard names of the arguments of methods of single-run components."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import unknown

MEANINGS: Mapping[str, str] = {
    "k": "time index",
    "t": "time k Ts [s]",
    "x": "state of the plant",
    "u": "applied input, within the bounds of the plant",
    "y": "measured output y(k)",
    "r": "reference: r(k) with preview = 1, else r(k), r(k+1), .. row by row",
    "w": "process noise w(k)",
    "v": "measurement noise v(k)",
    "p": "parameters of the plant in this run, as p.name and p['name']",
    "x_hat": "estimate of the state",
    "P": "reported covariance of x_hat - x; None where there is none",
    "e": "innovation y - C x_pred, where the estimator reports it as `e`; else None",
    "x0": "initial state: of a plant the true one, of an estimator the assumed one",
    "P0": "covariance of the initial estimate",
    "M0": "shape matrix of the set of the initial estimate",
    "u_previous": "u(k-1) that has acted; None at k = 0",
    "u_command": "input of the controller before the bounds of the plant",
    "Ts": "sampling time [s]",
    "model": "design model",
    "n_steps": "number of control periods N",
    "rng": "random generator of this run",
    "run": "index of the run",
    "limits": "limits of the signals of the plant: low, high = limits.u",
    "plant_info": "sizes, names, units and nominal parameters of the plant",
    "info": "what the estimator reports at k besides x_hat and P",
    "prepared": "what `prepare` returned",
    "estimator": "design of the estimator",
    "plant": "the true system; an estimator with this argument is an oracle estimator",
}
"""Every standard name with its meaning."""

_RUN = ("rng", "run")
_DESIGN: Mapping[str, tuple[str, ...]] = {
    "estimators": ("model", "Ts", "n_steps", "x0", "P0", "M0", "limits", "plant_info", "plant"),
    "controllers": ("model", "Ts", "n_steps", "limits", "plant_info", "estimator"),
    "plants": ("Ts", "n_steps"),
    "metrics": (),
}
"""Names that are known before any run, by group."""
_SAMPLE: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "estimators": {
        "start": (),
        "update": ("y", "u_previous", "k", "t"),
        "predict": ("u", "k", "t"),
        "correct": ("y", "k", "t"),
    },
    "controllers": {
        "start": (),
        "control": ("x_hat", "r", "y", "u_previous", "P", "e", "info", "k", "t"),
    },
    "plants": {
        "start": ("p", "x0"),
        "step": ("u", "w", "x", "p", "k", "t"),
        "output": ("x", "v", "p", "k", "t"),
    },
    "metrics": {"evaluate": ("x", "y", "x_hat", "u", "u_command", "r", "P", "t", "Ts", "info", "k")},
}
"""Names of one run or one sample, by group and method."""


def a_component(group: str) -> str:
    """Return the noun of a group with its article, such as ``an estimator``."""
    noun = group.removesuffix("s")
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def snake_case(name: str) -> str:
    """Write the name of a class as that of a column.

    Examples
    --------
    >>> snake_case("PeakInput")
    'peak_input'
    """
    parts = [("_" if i and c.isupper() and not name[i - 1].isupper() else "") + c.lower() for i, c in enumerate(name)]
    return "".join(parts)


def design_words(group: str) -> tuple[str, ...]:
    """Names of a group that are known before any run; they are no keys of the configuration."""
    return _DESIGN[group]


def words(group: str, method: str) -> tuple[str, ...]:
    """Names that the arguments of a method may have; `__init__` and `prepare` have keys of the configuration, too."""
    known = _DESIGN[group]
    if method == "prepare":
        return tuple(word for word in known if word not in ("x0", "P0", "M0"))
    run = ("prepared", *_RUN) if group != "metrics" else ()
    return (*_SAMPLE[group].get(method, ()), *known, *run)


class Arguments:
    """Arguments of a user's function but ``self``, in their order; `owner`, as ``MyFilter.update``, is for messages."""

    def __init__(self, function: Callable[..., Any], owner: str, *, bound: bool) -> None:
        parameters = list(inspect.signature(function).parameters.values())[0 if bound else 1 :]
        kinds = inspect.Parameter
        if any(each.kind is kinds.VAR_POSITIONAL for each in parameters):
            raise DesignError(f"{owner} takes *arguments; name every argument: each is given by its name", "kind")
        self.owner = owner
        self.parameters = {each.name: each for each in parameters if each.kind is not kinds.VAR_KEYWORD}
        self.takes_all = len(self.parameters) < len(parameters)
        """Whether there is a ``**keys``."""
        by_place = [name for name, each in self.parameters.items() if each.kind is not kinds.KEYWORD_ONLY]
        self.by_key = tuple(name for name in self.parameters if name not in by_place)
        self.names = (*by_place, *self.by_key)

    def check(self, known: tuple[str, ...]) -> None:
        """Refuse the first argument that is not one of the known names; the DesignError has the nearest one."""
        for name in self.names:
            if name in known:
                continue
            if name in MEANINGS:
                raise DesignError(
                    f"{self.owner} cannot have the argument {name!r}; its arguments may be {', '.join(known)}", "kind"
                )
            raise DesignError(f"{self.owner}: {unknown(name, known, 'argument')}", "kind")

    def bind(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function as one that takes all arguments by their place, in the order of `names`."""
        if not self.by_key:
            return function
        n = len(self.names) - len(self.by_key)

        def call(*values: Any) -> Any:
            return function(*values[:n], **dict(zip(self.by_key, values[n:], strict=True)))

        return call


def arguments_of(owner: type, method: str) -> Arguments:
    """Read the arguments of a method of a class, without its ``self`` or ``cls``."""
    static = isinstance(inspect.getattr_static(owner, method), staticmethod | classmethod)
    return Arguments(getattr(owner, method), f"{owner.__qualname__}.{method}", bound=static)
