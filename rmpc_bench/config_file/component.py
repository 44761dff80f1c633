"""A component of a configuration (a plant, a model, an estimator and so on) with its position in the file."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Len
from pydantic import BaseModel

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.components.designs import is_built_in, registered_design
from rmpc_bench.components.loading import reference_of, user_code
from rmpc_bench.components.reference import CodeError, CodeReference, DataReference, is_reference
from rmpc_bench.components.transport import Recipe, inside
from rmpc_bench.config_file.keys import keys_of, keys_with_files, own_first, shown, validate
from rmpc_bench.config_file.tree import (
    FILE,
    Map,
    Mark,
    Problems,
    given_forms,
    join,
    locate,
    locate_key,
    split,
    with_kind,
)
from rmpc_bench.config_file.user_files import placed
from rmpc_bench.expressions.quantity import Expression
from rmpc_bench.extras import MissingLibraryError, missing_for
from rmpc_bench.models.delay import DelayKey
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.models.linear import HeldModel
from rmpc_bench.simulation.open_loop import Held
from rmpc_bench.simulation.scenario import initial_state
from rmpc_bench.types import ConfigError, Count, DesignError, Issue, Problem, contract
from rmpc_bench.types.basics import declaring

SHARED_KEYS: Mapping[str, Mapping[str, Any]] = {
    "models": {"disturbance": Disturbance, "delay": DelayKey},
    "controllers": {"every": Count, "preview": bool},
    "inputs": {"only": Annotated[list[str | int], Len(1)], "known": bool},
}  # group -> keys that every component of it has, with what validates them
HELD = ("control-lqr", "gpc", "lqg", "lqr", "mpc", "pid")
"""Kinds of controllers that may be called at every m-th sample; others count with the noise of single samples."""
NONE = "none"
"""Value of `disturbance` that stands for no value, so that a method can do without a default of all methods."""
DELAY_OF_PLANT = "a delay is a law of a channel: noise: {input: {delayed: 2}}"
Writer = Callable[[CodeReference | DataReference], str]
"""Returns what stands in plain data for something in a file of the user."""


def as_given(reference: CodeReference | DataReference) -> str:
    """Return a reference as the configuration writes it."""
    return reference.text


def without_path(reference: CodeReference | DataReference) -> str:
    """Return what a reference names, but not where it lies: its content counts by its hash."""
    return reference.name if isinstance(reference, CodeReference) else "data"


@dataclass(frozen=True, eq=False)
class Component:
    """A validated component, ready to be built."""

    group: str  # group of the registry
    kind: str  # its name there, or ``PATH.py:NAME`` for a component from a file
    # keywords of the design function, with references in place of what stands in files of the user
    parameters: Mapping[str, Any]
    tree: Map  # the mapping it was read from, with its marks
    path: tuple[str | int, ...]  # where it stands in the configuration
    design: Callable[..., Any]  # the design function or class
    code: CodeReference | None = None  # where a component from a file stands; None for others
    # keys that every component of the group has; those that are not given are left out
    shared: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def build(self, **provided: Any) -> Any:
        """Call the design function with those provided objects that it takes; a ConfigError where it refuses them."""
        with self._errors_placed():
            return self.made(provided)

    def made(self, provided: Mapping[str, Any]) -> Any:
        """Call the design function as `build` does; exceptions are not caught."""
        taken = inspect.signature(self.design).parameters
        given = {name: value for name, value in provided.items() if name in taken and name not in self.parameters}
        recipe = Recipe(self.group, self.design, self.code, given, self.parameters)
        made = contract.checked(self.group, self.kind, recipe.make(), provided)
        if not self.is_built_in:
            recipe.remember(made)
        return made

    def build_law(self, *, inputs: Sequence[int] | None = None, **provided: Any) -> Any:
        """Build a controller; with `every: m` it is designed for a model over m samples, and its input is held.

        With `preview: false` it predicts with r(k) for all samples ahead.  The law has the `inputs`, or all.
        """
        every, preview, model = self.shared.get("every", 1), self.shared.get("preview", True), provided["model"]
        if not preview and (self.code is not None or self.kind not in ("gpc", "mpc")):
            raise self.error("is a key of gpc and mpc", "preview")
        if every == 1 and inputs is None:
            made = self.build(**provided)
            return made if preview else Held(made, 1, np.eye(model.nx), knows_ahead=False)
        if every > provided["n_steps"]:
            raise self.error(f"must be at most the number of samples, {provided['n_steps']}", "every")
        if every > 1 and (self.code is not None or self.kind not in HELD):
            raise self.error(f"is a key of {', '.join(HELD)}", "every")
        try:
            # A state-dependent model raises a DesignError, which says how it becomes a linear one.
            over = HeldModel(model, every, inputs)
        except DesignError as error:
            if self.kind not in registry.NONLINEAR["controllers"]:
                key = "every" if every > 1 else ""
                raise self.error(f"{key or 'it'} needs a linear model: {error}", key) from None
            over, model = None, model if inputs is None else declaring(model, nu=len(inputs))
        size = {"model": over or model, "Ts": every * provided["Ts"], "n_steps": -(-provided["n_steps"] // every)}
        made = self.build(**{**provided, **size})
        return Held(made, every, np.eye(model.nx) if over is None else over.held, knows_ahead=preview)

    def extended(self, made: Any, *, n_steps: int, x_hat: Any) -> Any:
        """Return a built design model with its disturbances; a ConfigError blames one of their parameters.

        `n_steps` is the number of control periods N, `x_hat` the initial estimate as configured.
        """
        keys = self.shared.get("disturbance")
        if keys is None:
            return made
        # Imported here: most configurations have no disturbances.
        from rmpc_bench.models.disturbed import with_disturbance

        try:
            with np.errstate(all="ignore"):
                return with_disturbance(made, keys, n_steps, initial_state(x_hat, made.nx))
        except DesignError as error:
            raise self.error(str(error), f"disturbance.{error.parameter}".rstrip(".")) from None

    def check(self, issues: Callable[[], Iterable[Issue]]) -> None:
        """Call what finds issues of the built component; a ConfigError has them at the keys to blame."""
        with self._errors_placed():
            found = [*issues()]
        Problems(self.problem(issue.message, issue.key) for issue in found).stop()

    @contextmanager
    def _errors_placed(self) -> Iterator[None]:
        """Raise a ConfigError with the place of what is wrong for an error of something of the component."""
        try:
            # An overflow is refused by the design function or shows as a failed run.
            with np.errstate(all="ignore"), nullcontext() if self.is_built_in else user_code():
                yield
        except DesignError as error:
            raise self.error(str(error), error.parameter) from None
        except CodeError as error:
            raise self.error(error.line) from None
        except MissingLibraryError as error:
            raise self.error(str(error)) from None
        except (np.linalg.LinAlgError, ArithmeticError, MemoryError) as error:
            raise self.error(f"cannot be computed from these numbers ({error})") from None

    @property
    def is_built_in(self) -> bool:
        """Whether the component is one of this package and names nothing in a file of the user."""
        return self.code is None and is_built_in(self.group, self.kind) and not self.references()

    @property
    def keys(self) -> type[BaseModel]:
        """The pydantic model of its keys."""
        return keys_of(self.group, self.kind, self.design)

    def without_shared(self, *names: str) -> Component:
        """Return the component without the keys that every component of its group has, or without some of them."""
        left = {name: value for name, value in self.shared.items() if names and name not in names}
        return dataclasses.replace(self, shared=left) if len(left) < len(self.shared) else self

    def takes(self, name: str) -> bool:
        """Whether the design function has a parameter of this name that is no key."""
        return name in inspect.signature(self.design).parameters and name not in self.parameters

    def references(self) -> tuple[CodeReference, ...]:
        """Return what the component uses in Python files of the user: its own file, and those that its keys name."""
        return tuple(dict.fromkeys(each for each in self._named if isinstance(each, CodeReference)))

    def data(self) -> tuple[DataReference, ...]:
        """Return the paths and patterns of data files that its keys name."""
        return tuple(each for each in self._named if isinstance(each, DataReference))

    @cached_property
    def _named(self) -> tuple[CodeReference | DataReference, ...]:
        """Its own place in a file of the user, and what its keys name in such files."""
        # Found once, since keys may hold large matrices.
        own = self.code or reference_of(self.design)
        return (*([] if own is None else [own]), *inside(self.parameters))

    def problem(self, message: str, parameter: str = "") -> Problem:
        """Return a problem of this component, at the parameter to blame."""
        quoted = '"' in parameter
        steps = split(parameter, self.tree.mark) if quoted else parameter.split(".") if parameter else []
        shown_steps = [FILE] if steps == ["kind"] and self.code is not None else steps
        return Problem(*locate(self.tree, steps), join([*self.path, *shown_steps]), message)

    def error(self, message: str, parameter: str = "") -> ConfigError:
        """Return an error of this component, at the parameter to blame."""
        return ConfigError([self.problem(message, parameter)])

    def resolved(self, write: Writer = as_given) -> dict[str, Any]:
        """Return the component as plain data with every default; `write` replaces what is from a file of the user."""
        kind = {"kind": self.kind} if self.code is None else {"file": write(self.code)}
        keys = {**self.parameters, **self.shared}
        return {**kind, **{name.rstrip("_"): plain_data(value, write) for name, value in keys.items()}}


def plain_data(value: Any, write: Writer = as_given) -> Any:
    """Return dataclasses, tuples and expressions as plain YAML data; keys that are not set are left out."""
    if isinstance(value, Expression):
        return "".join(value.text.split())
    if isinstance(value, CodeReference | DataReference):
        return write(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = own_first(type(value), (field.name for field in dataclasses.fields(value)))
        fields = {name: getattr(value, name) for name in names}
        return {name.rstrip("_"): plain_data(item, write) for name, item in fields.items() if item is not None}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: plain_data(item, write) for name, item in value.items() if item is not None}
    return [plain_data(item, write) for item in value] if isinstance(value, list | tuple) else value


def read_component(
    group: str,
    tree: Any,
    path: Sequence[str | int],
    *,
    mark: tuple[str, int, int],
    kind: str | None = None,
    ignore: Sequence[str] = (),
    access: CodeAccess = NO_ACCESS,
) -> Component:
    """Validate a component against the signature of its design function; a ConfigError has all that is wrong.

    `mark` is the place to show when the tree has none of its own, `kind` counts where there is no such key.  Keys to
    ignore are validated elsewhere.  `access` says which files of the user may be loaded.
    """
    if not isinstance(tree, Map):
        raise ConfigError([Problem(*mark, join(path), f"must be a mapping (got {shown(tree)})")])
    if kind is None:
        tree = with_kind(group, tree)
        kind = _kind(group, tree, path)
    code, design = _design(group, kind, tree, path, mark, access)
    kind = kind if code is None else code.text
    model = keys_of(group, kind, design)
    own, problems = tree.copy(), Problems()
    for key in ("kind", *ignore):
        own.pop(key, None)
    if FILE in own and FILE not in {field.alias or name for name, field in model.model_fields.items()}:
        del own[FILE]
        place = locate_key(tree, [FILE])
        problems.append(Problem(*place, join([*path, FILE]), "stands for `kind`; give one of the two"))
    if group == "plants" and "delay" in own and "delay" not in model.model_fields:
        del own["delay"]
        problems.append(Problem(*locate_key(tree, ["delay"]), join([*path, "delay"]), DELAY_OF_PLANT))
    shared = {}
    for name, annotation in SHARED_KEYS.get(group, {}).items():
        # A component of a user may have had a key of this name before.
        if name not in own or name in model.model_fields:
            continue
        place, value = locate(own, [name]), own.pop(name)
        if value is not None and (value != NONE or name != "disturbance"):
            shared[name] = problems.tried(validate, annotation, value, [*path, name], mark=place)
    own = placed(own, keys_with_files(group, kind, design), access)
    checked = problems.tried(validate, model, own, path, further=[*SHARED_KEYS.get(group, {})])
    problems.stop()
    parameters = {name: getattr(checked, name) for name in model.model_fields}
    return Component(group, kind, parameters, tree, tuple(path), design, code, shared)


def _design(
    group: str, kind: str, tree: Map, path: Sequence[str | int], mark: tuple[str, int, int], access: CodeAccess
) -> tuple[CodeReference | None, Callable[..., Any]]:
    """Return the reference and the design function of a component, whose keys can be read."""
    kind_mark = locate(tree, ["kind"]) if "kind" in tree else Mark(*mark)
    if lacking := missing_for(group, kind):
        form = kind if kind in given_forms(group, tree) else "kind"
        raise ConfigError([Problem(*kind_mark, join([*path, form]), lacking)])
    try:
        code = access.reference(kind, kind_mark.file) if is_reference(kind) else None
        design = registered_design(group, kind) if code is None else access.load(code, group)
        if not is_built_in(group, kind):
            with user_code(None if code is None else code.path):
                keys_of(group, kind if code is None else code.text, design)
        return code, design
    except CodeError as error:
        step = FILE if is_reference(kind) else "kind"
        raise ConfigError([problem_of(error, kind_mark, join([*path, step]))]) from None


def build_component(group: str, data: Mapping[str, Any] | None, **provided: Any) -> Any:
    """Build a component from plain data with ``kind`` and keys; None where there are none or they are invalid.

    A model needs the initial estimate `x_hat`, as configured, among the provided objects.
    """
    if data is None:
        return None
    mark = Mark("", 1, 1)
    try:
        component = read_component(group, Map(data, mark=mark), [], mark=mark)
        made = component.build(**provided)
        x_hat = provided.get("x_hat", 0.0)
        return component.extended(made, n_steps=provided["n_steps"], x_hat=x_hat) if component.shared else made
    except ConfigError:
        return None


def problem_of(error: CodeError, mark: Mark, path: str) -> Problem:
    """Return an error of a user's file as a problem: at its place in that file, else at the name of the file."""
    return Problem(*mark, path, str(error)) if error.place is None else Problem(*error.place, "", str(error))


def _kind(group: str, tree: Map, path: Sequence[str | int]) -> str:
    noun = registry.singular(group)
    if "kind" not in tree:
        forms = given_forms(group, tree)
        known = ", ".join(registry.names(group))
        message = f"'kind' is missing; known kinds of {noun}: {known}; or file: PATH.py:NAME"
        if forms:
            message = f"{' and '.join(forms)} each give the kind of {noun}; give one of them"
        raise ConfigError([Problem(*tree.mark, join(path), message)])
    kind = tree["kind"]
    if isinstance(kind, str) and (is_reference(kind) or registry.is_known(group, kind)):
        return kind
    written = FILE if isinstance(kind, str) and ".py" in kind else "kind"
    message = registry.unknown_kind(str(kind), group)
    if written == FILE:
        message = f"must name something in a Python file, PATH.py:NAME (got {kind!r})"
    raise ConfigError([Problem(*locate(tree, ["kind"]), join([*path, written]), message)])
