"""Versions of the libraries with which components compute: another major or minor version may compute other numbers.

They are those that the user's files import, also through an adapter, and those of built-in components that need one.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable

from rmpc_bench.components.reference import distribution_of
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution.other_code import stored_methods
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.store.store import Store

OF_THE_BENCH = ("numpy", "scipy", "numba", "joblib", "pandas")
"""Libraries of the bench itself: another version of them is reported, as for built-in components, and not refused."""
_KEY = "libraries"


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
    stored, here = _stored(store), _here(config, methods)
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
        _note(store, _stored(store), here)


def _here(config: ExperimentConfig, methods: Collection[str]) -> dict[str, tuple[str, dict[str, str]]]:
    """Return key of the trials -> name of the method, and the versions of the libraries that it uses."""
    modules = {key: point.modules.get(name, ()) for point in config.points for name, key in point.method_keys.items()}
    return {
        method.key: (method.name, {name: text for name, text in found.items() if name not in OF_THE_BENCH})
        for method in stored_methods(config, methods)
        if (found := versions(modules[method.key]))
    }


def _stored(store: Store) -> dict[str, dict[str, list[str]]]:
    """Return key of the trials -> library -> the versions that have computed them."""
    return store.data(_KEY)


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
