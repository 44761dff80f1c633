"""What is marked with `single_run`, read once: its methods, the standard names of their arguments, and its keys."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_type_hints

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
"""Names that are known before any run, by group; they are no keys of the configuration."""
_SAMPLE: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "estimators": {
        "start": (),
        "update": ("y", "u_previous", "k", "t"),
        "predict": ("u", "k", "t"),
        "correct": ("y", "k", "t"),
    },
    "controllers": {"start": (), "control": ("x_hat", "r", "y", "u_previous", "P", "e", "info", "k", "t")},
    "plants": {"start": ("p", "x0"), "step": ("u", "w", "x", "p", "k", "t"), "output": ("x", "v", "p", "k", "t")},
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


def class_of(group: str, method: str, function: Callable[..., Any]) -> type:
    """Return a class whose method calls a function; arguments without a standard name are keys of the configuration."""
    parameters = inspect.signature(function).parameters
    known = words(group, method)
    keys = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for name, each in parameters.items() if name not in known]
    asked = [name for name in parameters if name in known]

    class FunctionComponent:
        """Keys of the function as attributes."""

        def __init__(self, **given: Any) -> None:
            self.given = given

    def call(self: Any, *values: Any) -> Any:
        return function(**dict(zip(asked, values, strict=True)), **self.given)

    of_self = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    of_call = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in asked]
    FunctionComponent.__init__.__signature__ = inspect.Signature([of_self, *keys])  # type: ignore[attr-defined]
    call.__signature__ = inspect.Signature([of_self, *of_call])  # type: ignore[attr-defined]
    setattr(FunctionComponent, method, call)
    FunctionComponent.__name__ = FunctionComponent.__qualname__ = function.__name__
    FunctionComponent.__module__ = function.__module__
    FunctionComponent.__doc__ = function.__doc__
    return FunctionComponent


def metric_design(cls: type) -> Callable[..., Any]:
    """Return the design function of a class derived from `Metric`.

    Annotated attributes are its keys, also without ``@dataclass``.  The column has the name of the class or its `name`.
    """
    if cls.__dict__.get("__annotations__") and "__dataclass_fields__" not in vars(cls) and "__init__" not in vars(cls):
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)
    signature = inspect.signature(cls)
    name = signature.parameters.get("name")
    if name is None or name.default is not inspect.Parameter.empty:
        return cls
    # Resolved here, since inherited annotations belong to the module of their own class.
    hints = get_type_hints(cls, include_extras=True)
    changed = [
        each.replace(
            annotation=hints.get(key, each.annotation),
            default=snake_case(cls.__name__) if key == "name" else each.default,
        )
        for key, each in signature.parameters.items()
    ]
    ordered = inspect.Signature([each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in changed])

    def design(**keys: Any) -> Any:
        bound = ordered.bind(**keys)
        bound.apply_defaults()
        return cls(**bound.arguments)

    design.__signature__ = ordered  # type: ignore[attr-defined]
    design.__doc__ = inspect.getdoc(cls)
    design.__name__, design.__qualname__, design.__module__ = cls.__name__, cls.__qualname__, cls.__module__
    return design


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


def methods_of(group: str, cls: type) -> tuple[str, ...]:
    """Return the methods with which a class is a component of a group; empty where it has not all of them."""
    known = METHODS.get(group, ())
    return next((names for names in known if all(callable(getattr(cls, name, None)) for name in names)), ())


class UserClass:
    """What the bench knows of a single-run component; a DesignError for a missing method or an unknown argument."""

    def __init__(self, group: str, cls: type, component: Any) -> None:
        self.group, self.cls, self.name, self.component = group, cls, cls.__qualname__, component
        self.methods = methods_of(group, cls)
        if not self.methods:
            raise DesignError(self._incomplete(), "kind")
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
        names = [name for each in METHODS[self.group] for name in each]
        own = [name for name in vars(self.cls) if callable(getattr(self.cls, name)) and not name.startswith("_")]
        # A method that is there is neither misspelt nor what another name should have been.
        lacking = [name for name in names if not callable(getattr(self.cls, name, None))]
        near = [unknown(name, lacking, "method") for name in own if name not in names]
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
        known = [word for word in _DESIGN[self.group] if word in asked or word in ALWAYS[self.group]]
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
