"""The component under test: where it comes from, and how its design is made, in any process."""

from __future__ import annotations

import inspect
import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.loading import load
from rmpc_bench.components.reference import CodeReference, split_reference
from rmpc_bench.components.single_run import design_function
from rmpc_bench.components.transport import dumps, loaded, loads
from rmpc_bench.types import ConfigError, DesignError, contract
from rmpc_bench.types.contract import BASES
from rmpc_bench.types.errors import unknown


@dataclass(frozen=True)
class Subject:
    """A component under test as a recipe, so that it can be made in every process."""

    text: str  # how the report names it
    group: str = ""  # group of the registry; empty where it follows from the component
    code: CodeReference | None = None  # file and name; None for a component of an installed module or of the registry
    module: str = ""  # module, name: installed module and name in it; a module of ``""`` is a kind of the registry
    name: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)  # keywords of its design function
    written: bool = False  # whether the keys are those of a configuration, which are validated as such
    value: Any = None  # the class or function itself, where it stands neither in a file nor in a module
    # what an experiment provides in place of what the checks provide
    provided: Mapping[str, Any] = field(default_factory=dict)

    def loaded(self) -> Any:
        """Import what it names: a class or a function."""
        if self.value is not None:
            return self.value
        if self.code is not None:
            return load(self.code)
        if not self.module:
            return registry.get(self.group, self.name)
        found: Any = import_module(self.module)
        for name in self.name.split("."):
            found = getattr(found, name)
        return found

    def made(self, group: str, provided: Mapping[str, Any]) -> Any:
        """Make the design."""
        design, provided = design_function(group, self.loaded()), {**provided, **self.provided}
        parameters = inspect.signature(design).parameters
        given = {name: provided[name] for name in parameters if name in provided and wanted(parameters[name], name)}
        keys = self._validated(group, design) if self.written else loaded(self.keys)
        wrong = [name for name in keys if name not in parameters]
        if wrong and not any(each.kind is each.VAR_KEYWORD for each in parameters.values()):
            known = [name for name in parameters if name not in given]
            raise DesignError(unknown(wrong[0], known, f"key of {self.text}"))
        missing = [
            name
            for name, each in parameters.items()
            if each.default is each.empty and name not in (*given, *keys) and each.kind not in _COLLECTING
        ]
        if missing:
            raise DesignError(f"needs a value for {', '.join(missing)}; give it as a key")
        return contract.checked(group, self.text, design(**given, **keys), provided)

    def _validated(self, group: str, design: Any) -> dict[str, Any]:
        """Validate the keys as those of a configuration."""
        # Validation needs pydantic, which a component without keys need not wait for.
        from rmpc_bench.config_file.keys import keys_of, validate

        try:
            checked = validate(keys_of(group, self.text, design), self.keys, [])
        except ConfigError as error:
            raise DesignError("; ".join(f"{each.path}: {each.message}" for each in error.found)) from None
        return {name: loaded(getattr(checked, name)) for name in type(checked).model_fields}


def packed(subject: Subject, job: Any) -> bytes:
    """Pickle a job for another process.

    What stands in a file is loaded there from the file, as it is now; a class of a notebook is sent by value.
    """
    # What an experiment provides may contain functions of the user's files.
    by_value = subject.value is not None or bool(subject.provided)
    return pickle.dumps((by_value, dumps(job) if by_value else pickle.dumps(job)))


def unpacked(data: bytes) -> Any:
    """Return the job that `packed` has made."""
    by_value, content = pickle.loads(data)
    return loads(content) if by_value else pickle.loads(content)


_COLLECTING = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)


def wanted(parameter: inspect.Parameter, name: str) -> bool:
    """Whether a parameter gets what the bench provides: sets of bounded noises only where there is no default."""
    return name != "M0" or parameter.default is parameter.empty


def subject_of(
    component: Any, group: str = "", keys: Mapping[str, Any] | None = None, *, written: bool = False
) -> Subject:
    """Return the recipe of a component: a class, a design function, ``PATH.py:NAME`` or a name of the registry."""
    keys = keys or {}
    if isinstance(component, str):
        parts = split_reference(component)
        if parts is None:
            group = group or next((each for each in registry.BUILT_IN if component in registry.names(each)), "")
            if not group:
                raise DesignError(f"{component!r} is neither PATH.py:NAME nor a name of a component")
            return Subject(component, group, None, "", component, keys, written)
        path, name = Path(parts[0]).resolve(), parts[1]
        return Subject(component, group, CodeReference(path, name, component), "", "", keys, written)
    name = getattr(component, "__qualname__", "")
    if not name:
        raise DesignError(f"an object of type {type(component).__name__} is no class and no design function")
    if "<" in name or component.__module__ == "__main__":
        return Subject(name.rpartition(">.")[2], group, None, "", "", keys, value=component)
    file = getattr(sys.modules.get(component.__module__), "__file__", None)
    is_own = component.__module__.partition(".")[0] == "rmpc_bench"
    if is_own or file is None or "site-packages" in Path(file).parts:
        # Another process can import the module by its name.
        return Subject(name, group, None, component.__module__, name, keys)
    path = Path(str(file)).resolve()
    return Subject(name, group, CodeReference(path, name, f"{path.name}:{name}"), "", "", keys)


def groups_of(component: Any) -> Sequence[str]:
    """Return the groups that a component may belong to, the likeliest one first."""
    known: list[str] = []
    if inspect.isclass(component):
        known += [group for group, base in BASES.items() if issubclass(component, base)]
        known += [group for method, group in _METHODS if callable(getattr(component, method, None))]
    return known[:1] or _GUESSES


_METHODS = (
    ("update", "estimators"),
    ("correct", "estimators"),
    ("control", "controllers"),
    ("step", "plants"),
    ("evaluate", "metrics"),
    ("sample", "references"),
)
"""Method of a single-run component -> its group."""
_GUESSES = ("estimators", "controllers", "plants", "references", "noises", "metrics", "figures")
"""Groups that are tried for a design function, whose result says what it is."""


def group_of(subject: Subject, provided: Callable[[str], Mapping[str, Any]]) -> str:
    """Find the group of a component."""
    if subject.group:
        return subject.group
    candidates = groups_of(subject.loaded())
    if len(candidates) == 1:
        return candidates[0]
    reasons = []
    for group in candidates:
        try:
            subject.made(group, provided(group))
        except Exception as error:  # a design function may raise anything for the wrong arguments
            reasons.append(f"{registry.singular(group)}: {error}")
            continue
        return group
    raise DesignError(f"{subject.text} is no component ({'; '.join(reasons)}); say which with --group")
