"""Stored rows that other code has computed: they are kept apart under their own keys and enter no table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from rmpc_bench.config.code_version import code_version
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.store.differences import Names, changes
from rmpc_bench.store.store import Store, StoredMethod, each_once


@dataclass(frozen=True)
class OtherRows:
    """Rows that other code has computed and this code has not, in words; false where there are none.

    Parameters
    ----------
    numerics : rows of other arithmetic, ``800 rows of other code (NUMERICS 1, here 2) are kept apart``; may be empty
    files : a line per method whose files have changed, ``MHE: tanks.py has changed since 200 runs were stored``
    """

    numerics: str = ""
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
