"""Stored rows of other code or of other versions of libraries: the first are kept apart, the second are refused.

Rows of other code are under their own keys and enter no table.  Libraries are those that the user's files import, also
through an adapter, and those of built-in components that need one: another minor version may compute other numbers.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from rmpc_bench.components.reference import distribution_of
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import code_version
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.store.differences import Names, changes
from rmpc_bench.store.store import Store, StoredMethod, each_once


@dataclass(frozen=True)
class OtherRows:
    """Rows that other code has computed and this code has not, in words; false where there are none."""

    # rows of other arithmetic, ``800 rows of other code (NUMERICS 1, here 2) are kept apart``; may be empty
    numerics: str = ""
    # a line per method whose files have changed, ``MHE: tanks.py has changed since 200 runs were stored``
    files: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.numerics or self.files)

    def __str__(self) -> str:
        return "; ".join(text for text in (self.numerics, *self.files) if text)

    def said(self, numerics: str, files: str) -> list[str]:
        """Return a line each, with the given ends."""
        lines = [f"{self.numerics}{numerics}"] if self.numerics else []
        return lines + [f"{line}{files}" for line in self.files]


def rows_of_other_code(config: ExperimentConfig, store: Store, methods: Collection[str]) -> OtherRows:
    """Describe the rows that other code has computed and this code has not."""
    current = {key for point in config.points for key in point.method_keys.values()}
    names = store.file_names(config.own.names())
    return rows_kept_apart(stored_methods(config, methods), store, config.experiment.n_runs, names, current)


def rows_kept_apart(
    methods: Iterable[StoredMethod],
    store: Store,
    n_runs: int,
    names: Names | None = None,
    current: Collection[str] = (),
) -> OtherRows:
    """Describe the rows of some methods that other code has computed; `current` are the keys of all methods."""
    methods = list(methods)
    names = store.file_names() if names is None else names
    current = current or {method.key for method in methods}
    here, numbers, n_rows = code_version(), set[int](), 0
    files: Counter[tuple[str, str]] = Counter()
    for method in methods:
        for codes, n in store.of_other_code(method, n_runs, current):
            # Each run counts once, whatever has changed.
            other = {code["numerics"] for code in codes} - {here["numerics"]}
            numbers |= other
            n_rows += n if other else 0
            if not other:
                files[method.name, _changes(codes, method, names)] += n
    there = ", ".join(map(str, sorted(numbers)))
    text = f"{n_rows} rows of other code (NUMERICS {there}, here {here['numerics']}) are kept apart" if n_rows else ""
    return OtherRows(text, tuple(f"{name}: {what} since {n} runs were stored" for (name, what), n in files.items()))


def _changes(codes: Iterable[Any], method: StoredMethod, names: Names) -> str:
    """Say what has changed since one of the stored codes, that with the fewest changes."""
    found = [list(dict.fromkeys(changes(code, method.code, names).values())) for code in codes]
    fewest = min(found, key=len)
    return " and ".join(fewest)


def stored_methods(config: ExperimentConfig, methods: Collection[str]) -> list[StoredMethod]:
    """Return what identifies the trials of some methods at all points of the sweep, each once."""
    found = (
        StoredMethod(key, point.definitions[name], point.code[name], name)
        for point in config.points
        for name, key in point.method_keys.items()
        if name in methods
    )
    return each_once(found) if "runs" in config.evaluate else []


OF_THE_BENCH = ("numpy", "scipy", "numba", "joblib", "pandas")
"""Libraries of the bench itself: another version of them is reported, as for built-in components, and not refused."""
_KEY = "libraries"  # of a value in the store: key of the trials -> library -> the versions that have computed them


def versions(modules: Iterable[str]) -> dict[str, str]:
    """Return distribution -> version of imported modules; those that are not there are left out."""
    found = (distribution_of(module) for module in modules)
    return dict(sorted(each for each in found if each is not None))


def all_versions(config: ExperimentConfig) -> dict[str, str]:
    """Return distribution -> version of all modules with which a configuration computes."""
    of_files = {module for source in config.own.sources.values() for module in source.modules}
    return versions(of_files | {name for point in config.points for names in point.modules.values() for name in names})


def check_versions(config: ExperimentConfig, store: Store, methods: Collection[str], *, accept: bool) -> None:
    """Refuse stored rows that another major or minor version of a library has computed."""
    stored, here = store.data(_KEY), _here(config, methods)
    lines = []
    for key, (name, libraries) in here.items():
        for library, version in libraries.items():
            there = stored.get(key, {}).get(library, [])
            if there and _series(version) not in map(_series, there) and store.has_trials(key):
                n_runs = len(store.column(key, config.experiment.n_runs)[0])
                runs = f"{name}: {n_runs} stored runs were computed with {library} {', '.join(there)}"
                lines.append(f"{runs}; here {library} {version}")
    if lines and not accept:
        way_out = "--accept-versions uses these rows; --fresh computes all again"
        raise StoreError(
            "\n".join([f"{store.directory}: a library has another version", *dict.fromkeys(lines), way_out])
        )
    if lines:
        _note(store, stored, here)


def note_versions(config: ExperimentConfig, store: Store, methods: Collection[str]) -> None:
    """Note the versions with which rows are about to be computed."""
    here = _here(config, methods)
    if any(libraries for _, libraries in here.values()):
        _note(store, store.data(_KEY), here)


def _here(config: ExperimentConfig, methods: Collection[str]) -> dict[str, tuple[str, dict[str, str]]]:
    """Return key of the trials -> name of the method, and the versions of the libraries that it uses."""
    modules = {key: point.modules.get(name, ()) for point in config.points for name, key in point.method_keys.items()}
    return {
        method.key: (method.name, {name: text for name, text in found.items() if name not in OF_THE_BENCH})
        for method in stored_methods(config, methods)
        if (found := versions(modules[method.key]))
    }


def _note(store: Store, stored: dict[str, dict[str, list[str]]], here: dict[str, tuple[str, dict[str, str]]]) -> None:
    noted = dict(stored)
    for key, (_, libraries) in here.items():
        before = noted.get(key, {})
        noted[key] = before | {each: sorted({*before.get(each, []), text}) for each, text in libraries.items()}
    if noted != stored:
        store.set_meta(_KEY, json.dumps(noted))


def _series(version: str) -> list[str]:
    """Major and minor version."""
    return version.split(".")[:2]
