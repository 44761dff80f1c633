"""The files of a user: the hashes that identify code and data, and their names in a resolved configuration.

The hashes of a method count for its trials, those of the plant, the noise and the reference for the experiment, and
those of a metric for its values.  A path is never part of them.

A directory of results has copies of the Python files, ``code/<hash>/tanks.py``, so that its configuration loads from
any place and with the code that computed the trials.  Data files are named relative to the directory.  Every copy is
compared with its hash before any use.

Components from these files are called once before any run, by `FirstCalls`.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.components.loading import package_of, reference_of
from rmpc_bench.components.object_source import object_hash, registered_identity
from rmpc_bench.components.reference import split_reference
from rmpc_bench.components.source import Source, data_hash, reached_text, read_source
from rmpc_bench.components.user_code import replaced
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Items, Map, locate
from rmpc_bench.extras import COMPUTES_WITH, EXTRAS, NEEDED_BY
from rmpc_bench.received.consent import is_code
from rmpc_bench.received.plain_files import DamagedError, content_of
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Controller, Estimate, Estimator, Method, Plant, Problem
from rmpc_bench.types.result_layout import COPIES

if TYPE_CHECKING:
    from rmpc_bench.components.first_call import Sample


@dataclass
class OwnCode:
    """The files of a user that a configuration uses; every file is read once."""

    access: CodeAccess = NO_ACCESS  # what the configuration may load
    sources: dict[Path, Source] = field(default_factory=dict)  # Python file -> the file with all that it imports
    data: dict[Path, str] = field(default_factory=dict)  # data file -> its hash
    files: dict[str, Path] = field(default_factory=dict)  # Python file as the configuration names it -> the file
    patterns: set[str] = field(default_factory=set)  # paths and patterns of data files as the configuration names them
    # hash of a part of a Python file -> the part with all that it imports
    parts: dict[str, Source] = field(default_factory=dict)
    # components that a program or a notebook has registered, which no other process knows
    of_program: set[str] = field(default_factory=set)
    # whether a component is that of a method or a figure -> what such components replace for all others
    _replacing: dict[bool, dict[Problem, None]] = field(default_factory=lambda: {True: {}, False: {}})
    _with_data: set[Path] = field(default_factory=set)  # Python files of components of which keys name data files

    def identity(self, components: Mapping[str, Component | None], *, whole: bool = True) -> dict[str, Any]:
        """Return role -> hashes of files or names of packages, for ``sources``, ``installed`` and ``data``.

        It is empty where all is built in.  Not `whole`, only the part of a file counts on which a component depends.
        """
        found: dict[str, dict[str, list[str]]] = {"sources": {}, "installed": {}, "data": {}}
        for role, component in components.items():
            if component is not None and not (component.is_built_in and not component.data()):
                sources = self.sources_of(component) if whole else self._parts_of(component)
                found["sources"][role] = [source.sha for source in sources]
                self._replacing[whole] |= dict.fromkeys(self._replaced(component))
                registered = [*_registered(component)]
                found["installed"][role] = installed = [each for each in registered if isinstance(each, str)]
                if registered and _is_of_program(component, has_file=not installed):
                    self.of_program.add(f"{registry.singular(component.group)} {component.kind!r}")
                found["data"][role] = [self._hash(path) for path in self._data_files(component)]
        filled = {name: {role: value for role, value in roles.items() if value} for name, roles in found.items()}
        return {name: roles for name, roles in filled.items() if roles}

    def _replaced(self, component: Component) -> Iterator[Problem]:
        """Say what the files of a component have replaced when they were imported and when it was designed."""
        files = {str(file.path) for source in self.sources_of(component) for file in source.files}
        names = sorted({name for file in files for name in replaced.get(file, ())})
        if names:
            text = f"replaces {', '.join(names[:4])}{' and others' * (len(names) > 4)}, which other components use too"
            yield component.problem(f"{text}; it is put back: write a function or class of your own")

    def sources_of(self, component: Component) -> Iterator[Source]:
        """Yield the Python files of a component, each with all that it imports."""
        for reference in component.references():
            yield self.read(reference.file, reference.path)
        for each in _registered(component):
            if isinstance(each, Source):
                self.files.setdefault(each.path.name, each.path)
                yield self.sources.setdefault(each.path, each)

    def _parts_of(self, component: Component) -> Iterator[Source]:
        """Yield the parts of the Python files on which a component depends, each with all that they import."""
        references = {(each.path, each.name): each for each in component.references()}
        for source in self.sources_of(component):
            own = [name for path, name in references if path == source.path]
            text = source.files[0].content
            part = reached_text(text, own) if own else text
            if part == text:
                yield source
                continue
            made = read_source(source.path, _with_text(source, part))
            # Its copy is that of the whole file.
            first = made.files[0]._replace(content=text)
            self.parts[made.sha] = replace(made, files=(first, *made.files[1:]))
            yield made

    def read(self, name: str, path: Path) -> Source:
        """Return a Python file with all that it imports."""
        self.files.setdefault(name, path)
        if path not in self.sources:
            self.sources[path] = _read(path)
        return self.sources[path]

    def modules(self, components: Iterable[Component | None]) -> set[str]:
        """Return the installed modules that components compute with: imports of their files, and needed libraries."""
        given = [each for each in components if each is not None]
        own = (source for each in given if not each.is_built_in for source in self.sources_of(each))
        found = {name for source in own for name in source.modules}
        extras = (NEEDED_BY.get((each.group, each.kind)) for each in given)
        found |= {EXTRAS[extra] for extra in extras if extra is not None}
        found |= {package for each in given if (package := _package_of_environment(each))}
        return found | {COMPUTES_WITH[name] for name in found if name in COMPUTES_WITH}

    def names(self) -> dict[str, dict[str, str]]:
        """Return hash of a source or a data file -> names of its files -> their hashes, for messages."""
        found = {
            self.sources[path].sha: {_shown(name, each.place): each.digest for each in self.sources[path].files}
            for name, path in self.files.items()
        }
        shown = {path: name for name, path in self.files.items()}
        for sha, part in self.parts.items():
            found[sha] = {_shown(shown[part.path], each.place): each.digest for each in part.files}
        return found | {digest: {path.name: digest} for path, digest in self.data.items()}

    @property
    def problems(self) -> list[Problem]:
        """Errors of the Python files; what every method shares must replace nothing."""
        found = [self._placed(problem) for source in self.sources.values() for problem in source.problems]
        return [*found, *self._replacing[False]]

    @property
    def warnings(self) -> list[Problem]:
        """Places at which the syntax tree cannot show what the code depends on."""
        found = {warning for source in self.sources.values() for warning in source.warnings}
        for path, source in self.sources.items():
            # A file that a key names is hashed.
            found |= set(source.readings) if path not in self._with_data else set()
        return [*sorted(map(self._placed, found)), *self._replacing[True]]

    def _placed(self, problem: Problem) -> Problem:
        """Name a file as it is seen from the current directory, where that is shorter."""
        relative = os.path.relpath(problem.file)
        return replace(problem, file=relative) if len(relative) < len(problem.file) else problem

    def _data_files(self, component: Component) -> list[Path]:
        self.patterns |= {each.text for each in component.data()}
        for each in component.data():
            # A directory of results has copies of files that execute, since nobody has agreed to those elsewhere.
            if len(each.paths) == 1 and is_code(each.paths[0]):
                self.read(each.text, each.paths[0])
        files = sorted({path for each in component.data() for path in each.paths})
        if files:
            self._with_data |= {reference.path for reference in component.references()}
        return files

    def _hash(self, path: Path) -> str:
        if path not in self.data:
            self.data[path] = data_hash(path)
        return self.data[path]


def _read(path: Path) -> Source:
    """Read a file with all that it imports: the texts that were imported, and from now on only these."""
    package = package_of(path.parent)
    source = read_source(path, lambda file: package.sources.get(str(file)) or file.read_bytes())
    for file in source.files:
        # A module that is imported inside a function is imported much later, in a worker.
        if file.path.suffix == ".py" and file.path.is_relative_to(package.directory):
            package.sources.setdefault(str(file.path), file.content)
    return source


def _with_text(source: Source, text: bytes) -> Callable[[Path], bytes]:
    """Return what reads the files of a source, the first of them with another text."""
    contents = {file.path: file.content for file in source.files}
    return lambda path: text if path == source.path else contents.get(path) or path.read_bytes()


def _package_of_environment(component: Component) -> str:
    """Return the package that registers the environment ``package:Name-v0`` of a plant; empty for any other."""
    env = component.parameters.get("env") if (component.group, component.kind) == ("plants", "env") else None
    return env.partition(":")[0].partition(".")[0] if isinstance(env, str) and ":" in env else ""


def _registered(component: Component) -> Iterator[Source | str]:
    """Yield what identifies a component that a program or an installed package has registered."""
    group, kind = component.group, component.kind
    if component.code is None and kind not in registry.BUILT_IN[group]:
        found = registry.get(group, kind)
        if reference_of(inspect.unwrap(found)) is None:
            identity = registered_identity(group, kind)
            yield identity
            if isinstance(identity, Source) and inspect.unwrap(found).__module__ == "__main__":
                # A program may change values that its functions use, and define a class again and again in a loop.
                yield object_hash(found)


def _is_of_program(component: Component, *, has_file: bool) -> bool:
    """Whether a registered component stands in a program or a notebook, and in no module that can be imported."""
    group, kind = component.group, component.kind
    in_main = inspect.unwrap(registry.get(group, kind)).__module__ == "__main__"
    return registry.installed_component(group, kind) is None and (in_main or not has_file)


def _shown(name: str, place: str) -> str:
    """Name a file relative to the configuration, as its first file is named."""
    return name if place == os.path.basename(name) else os.path.normpath(os.path.join(os.path.dirname(name), place))


STORE = "trials.sqlite"
_WAY_OUT = "restore the file from the original, or `rmpc-bench run --fresh` computes everything again"
_WITHOUT_FILES = ("title", "summary", "label", "name", "claims", "statistics", "paper", "assumptions")
"""Keys under which no value names a file."""


def as_of_configuration(tree: Map, key: str, own: OwnCode) -> Any:
    """Return a section of a configuration as plain data, its files relative to the directory of the configuration."""

    def written(text: str, file: str) -> str:
        parts = split_reference(text)
        if parts is not None:
            return own.access.reference(text, file).text
        name = own.access.file(text, file).file
        return name if name in own.patterns or name in own.files else text

    return _replaced(tree[key], written, locate(tree, [key]).file)


def in_directory(resolved: Mapping[str, Any], directory: Path, own: OwnCode) -> dict[str, Any]:
    """Return a resolved configuration that names the copies in a directory of results."""

    def written(text: str, _: str) -> str:
        file, name = split_reference(text) or (text, "")
        if file in own.files:
            source = own.sources[own.files[file]]
            return f"{COPIES}/{source.folder}/{source.copy}" + (f":{name}" if name else "")
        if text in own.patterns:
            # The system follows a link before it goes up with `..`, in the directory of results, too.
            return Path(os.path.relpath(own.access.base("").resolve() / text, directory.resolve())).as_posix()
        return text

    changed: dict[str, Any] = _replaced(dict(resolved), written, "")
    return changed


def renamed(resolved: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return a resolved configuration with other names of files: as the configuration writes them -> others."""
    changed: dict[str, Any] = _replaced(dict(resolved), lambda text, _: names.get(text, text), "")
    return changed


def _replaced(node: Any, write: Callable[[str, str], str], file: str) -> Any:
    """Copy a tree into ordinary dicts and lists, with other texts."""
    if isinstance(node, str):
        return write(node, file)
    if isinstance(node, dict):
        return {
            key: value if key in _WITHOUT_FILES else _replaced(value, write, _file_of(node, key, file))
            for key, value in node.items()
        }
    if isinstance(node, list):
        return [_replaced(value, write, _file_of(node, number, file)) for number, value in enumerate(node)]
    return node


def _file_of(node: Any, step: str | int, file: str) -> str:
    return locate(node, [step]).file if isinstance(node, Map | Items) else file


def check_copies(directory: Path) -> None:
    """Raise `DamagedError` for a copy of a directory that is not the program of which its folder has the hash."""
    # A directory of configurations may have a folder of this name with files of its user.
    name = re.compile(".*" if (directory / STORE).exists() else "[0-9a-f]{16}")
    try:
        there = sorted(each for each in (directory / COPIES).iterdir() if name.fullmatch(each.name))
        folders = {each: _files(each) for each in there}
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise DamagedError(f"{directory / COPIES}: cannot be read ({error}); {_WAY_OUT}") from None
    wholes = {folder for folder, files in folders.items() if _is_whole(folder, files)}
    known = {content for folder in wholes for content in folders[folder].values()}
    for folder, files in folders.items():
        # The folder of a part of a file has the whole file, which then has a folder of its own.
        if folder not in wholes and not {*files.values()} <= known:
            raise DamagedError(f"{folder}: its files are not those that have computed the trials; {_WAY_OUT}")


def _files(folder: Path) -> dict[Path, bytes]:
    """Return the files of a folder with their contents, but for those that Python makes."""
    found: dict[Path, bytes] = {}
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        for name in names:
            path = Path(parent, name)
            if path.resolve() != folder.resolve() / path.relative_to(folder):
                raise OSError(f"{path} is a symbolic link")
            found[path] = content_of(path)
    return found


def _is_whole(folder: Path, files: Mapping[Path, bytes]) -> bool:
    """Whether every file has, with all that it imports, the hash of the folder, or is imported by one that has."""
    known = set[Path]()
    for path in files:
        source = read_source(path, lambda each: files.get(each) or content_of(each))
        if source.folder == folder.name:
            known |= {each.path for each in source.files}
    return {path.resolve() for path in files} == known


class FirstCalls:
    """The first calls of a configuration; points of a sweep with the same files share one.

    No code is called if they are `left_out`, since the process that asks has done it.
    """

    def __init__(self, *, left_out: bool = False) -> None:
        self.left_out = left_out
        self._estimates: dict[Any, Estimate | None] = {}

    def estimates(
        self, draft: DraftConfig, plant: Plant, methods: Sequence[Method], scenario: Scenario, n_steps: int
    ) -> dict[str, Estimate | None]:
        """Simulate two samples of every method with components from files; what is wrong is added to the draft.

        An error is a problem at the component.  A call that takes too long is a warning, since it may be only slow.
        """
        found: dict[str, Estimate | None] = {}
        for method in methods:
            named = _components(draft, method.name)
            files = tuple(each.references() for each in named.values())
            if not any(files):
                continue
            # Points with the same files and sizes differ in numbers only, and so do the values that tuning tries.
            key = method.name.partition("~")[0], files, plant.nx, plant.nu, plant.ny
            if key not in self._estimates:
                # Imported here: a configuration without files of the user needs none of it.
                from rmpc_bench.components.first_call import Sample

                r = scenario.reference.sample(method.controller.preview + 2)
                sample = Sample(scenario.x0, r, n_steps)
                self._estimates[key] = None if self.left_out else _called(draft, named, plant, method, sample)
            found[method.name] = self._estimates[key]
        return found


def _components(draft: DraftConfig, name: str) -> dict[str, Component]:
    """Return the plant, the estimator and the controller of a method."""
    parts = draft.methods[name]
    named = {"plant": draft.plant, "estimator": parts.estimator, "controller": parts.controller}
    return {role: each for role, each in named.items() if each is not None}


def _called(
    draft: DraftConfig, named: dict[str, Component], plant: Plant, method: Method, sample: Sample
) -> Estimate | None:
    from rmpc_bench.components.first_call import first_call

    answer = first_call(plant, method, sample)
    if answer.too_long is not None:
        component = named.get(answer.too_long.role, next(each for each in named.values() if each.references()))
        draft.warnings.append(component.problem(answer.too_long.message))
        return None
    for role, design in (("plant", plant), ("estimator", method.estimator), ("controller", method.controller)):
        _keep(design, answer.seconds.get(role), answer.warnings.get(role, ()))
    if answer.finding is not None and answer.finding.role in named:
        draft.problems.append(named[answer.finding.role].problem(answer.finding.message))
    return answer.estimate


def _keep(design: Plant | Estimator | Controller, seconds: float | None, warnings: tuple[str, ...]) -> None:
    """Note what a component written for one run costs, for the estimate of the computing time, and its warnings."""
    from rmpc_bench.components.single_design import SingleDesign

    if isinstance(design, SingleDesign):
        design.seconds_per_step = design.seconds_per_step if seconds is None else seconds
        more = [text for text in warnings if text not in design.remarks]
        design.__dict__["remarks"] = (*design.remarks, *more)
