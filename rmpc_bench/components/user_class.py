"""A class marked with `single_run`: its methods, their arguments and its keys, read once."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Literal

from rmpc_bench.components.function_component import class_of
from rmpc_bench.components.words import Arguments, a_component, arguments_of, design_words, snake_case, words
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import unknown

METHODS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "estimators": (("update",), ("predict", "correct")),
    "controllers": (("control",),),
    "plants": (("step", "output"),),
    "metrics": (("evaluate",),),
}
"""Group -> the methods that a class must have; one of the alternatives is enough."""
FUNCTION_METHODS: Mapping[str, str] = {"controllers": "control", "metrics": "evaluate"}
"""Groups whose single-run components may be functions -> the method that the function is."""
ALWAYS: Mapping[str, tuple[str, ...]] = {
    "estimators": ("model", "Ts", "n_steps", "x0", "P0"),
    "controllers": ("model", "Ts", "n_steps"),
    "plants": ("Ts", "n_steps"),
    "metrics": (),
}
"""What the bench needs itself of what is known before any run."""
HELD = ("estimators", "controllers")
"""Groups whose components have the keys `on_failure` and `max_held`."""
COMMON_KEYS: Mapping[str, str] = {
    "on_failure": "what follows a failed step: `stop` ends the run, `hold` continues with the last input, or the "
    "last estimate moved by the model",
    "max_held": "share of the steps of a run that may be held",
}
Failing = Literal["stop", "hold"]


class UserClass:
    """What the bench knows of a single-run component; a DesignError for a missing method or an unknown argument."""

    def __init__(self, group: str, cls: type, component: Any) -> None:
        self.group, self.cls, self.name, self.component = group, cls, cls.__qualname__, component
        complete = [each for each in METHODS[group] if all(callable(getattr(cls, name, None)) for name in each)]
        if not complete:
            raise DesignError(self._incomplete(), "kind")
        self.methods = complete[0]
        called = ("prepare", "start", *self.methods)
        self.arguments: dict[str, Arguments] = {
            name: arguments_of(cls, name) for name in called if callable(getattr(cls, name, None))
        }
        if "prepare" in self.arguments and not isinstance(inspect.getattr_static(cls, "prepare"), classmethod):
            raise DesignError(f"{self.name}.prepare must be a class method: write @classmethod above it", "kind")
        self.of_init = _of_init(cls)
        self.keys = self._keys()
        for name, arguments in self.arguments.items():
            arguments.check((*words(group, name), *(self.keys if name == "prepare" else ())))

    def _incomplete(self) -> str:
        wanted = " or ".join(" and ".join(each) for each in METHODS[self.group])
        names = {name for each in METHODS[self.group] for name in each}
        own = [name for name in vars(self.cls) if callable(getattr(self.cls, name)) and not name.startswith("_")]
        near = [unknown(name, names, "method") for name in own]
        hint = next((f": {text}" for text in near if "did you mean" in text), "")
        return f"{a_component(self.group)} written for one run has the method {wanted}; {self.name} has not{hint}"

    def _keys(self) -> dict[str, inspect.Parameter]:
        """Parameters of `__init__` that are keys of the configuration."""
        given = {*words(self.group, "__init__")}
        keys = {name: each for name, each in self.of_init.parameters.items() if name not in given}
        taken = set(COMMON_KEYS) & set(keys)
        if taken and self.group in HELD:
            raise DesignError(f"{sorted(taken)[0]!r} is a key of every single-run component; choose another", "kind")
        return keys

    @property
    def asked(self) -> set[str]:
        """Every name that some method asks for."""
        return {name for each in (self.of_init, *self.arguments.values()) for name in each.names}

    @property
    def provided(self) -> tuple[str, ...]:
        """Names that the design function takes from the bench; limits of signals are read from `plant_info`."""
        asked = self.asked | ({"plant_info"} if "limits" in self.asked else set())
        known = [word for word in design_words(self.group) if word in asked or word in ALWAYS[self.group]]
        return tuple(word for word in known if word != "limits")

    def signature(self) -> inspect.Signature:
        """Signature of the design function: what the bench provides, the keys of `__init__` and the common keys."""
        only = inspect.Parameter.KEYWORD_ONLY
        first = inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters = [inspect.Parameter(name, first if name == "model" else only) for name in self.provided]
        parameters += [each.replace(kind=only) for each in self.keys.values()]
        if self.group in HELD:
            parameters += [
                inspect.Parameter("on_failure", only, default="stop", annotation=Failing),
                inspect.Parameter("max_held", only, default=0.1, annotation=float),
            ]
        if self.group == "metrics" and "name" not in self.keys:
            parameters.append(inspect.Parameter("name", only, default=snake_case(self.cls.__name__), annotation=str))
        return inspect.Signature(parameters)

    @property
    def common_keys(self) -> Mapping[str, str]:
        """Keys that all single-run components of the group have, with their meanings."""
        return COMMON_KEYS if self.group in HELD else {}

    def constant(self, name: str, default: Any) -> Any:
        """Return an attribute of the class, or a default."""
        return getattr(self.cls, name, default)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by what the user has marked."""
        return user_class, (self.group, self.component)


def user_class(group: str, component: Any) -> UserClass:
    """Read a class, or a function as the only method of a class; a DesignError where it is not written for one run."""
    if isinstance(component, type):
        return UserClass(group, component, component)
    if group not in FUNCTION_METHODS:
        raise DesignError(f"{a_component(group)} written for one run is a class; this is a function", "kind")
    return UserClass(group, class_of(group, FUNCTION_METHODS[group], component), component)


def _of_init(cls: type) -> Arguments:
    """Read the arguments of `__init__`; without one there are none."""
    if cls.__init__ is object.__init__:  # type: ignore[misc]
        return Arguments(lambda: None, cls.__qualname__, bound=True)
    arguments = Arguments(cls.__init__, f"{cls.__qualname__}.__init__", bound=False)  # type: ignore[misc]
    if arguments.takes_all:
        raise DesignError(f"{arguments.owner} takes **keys; name every key, since each is checked", "kind")
    return arguments
