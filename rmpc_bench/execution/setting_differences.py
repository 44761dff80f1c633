"""What differs in the configurations of two directories of results, from their stored records; no code is loaded."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.execution import manifest
from rmpc_bench.execution.results import Results
from rmpc_bench.report.results_text import Setting
from rmpc_bench.store.store import Store
from rmpc_bench.types import ConfigError
from rmpc_bench.types.result_files import RESOLVED

SECTIONS = ("methods", "metrics", "statistics")
"""Sections of the resolved configuration that the experiment hash does not cover."""

LONGEST = 80
"""Characters of a value that are shown."""

MISSING = "-"
"""What stands for a value that one of the two does not have."""


def setting_differences(a: Results, b: Results) -> list[Setting]:
    """Return the settings that differ: hash, seed, options, what all methods share, methods and metrics."""
    found = [
        Setting(name, *texts)
        for name, texts in {
            "experiment hash": (a.experiment.hash[:12], b.experiment.hash[:12]),
            "options": (" ".join(a.overrides) or MISSING, " ".join(b.overrides) or MISSING),
            "runs": (str(a.experiment.n_runs), str(b.experiment.n_runs)),
        }.items()
        if texts[0] != texts[1]
    ]
    for path in dict.fromkeys([*a.experiment.paths, *b.experiment.paths]):
        swept = [dict.fromkeys(point.coordinates.get(path, "") for point in each.experiment.points) for each in (a, b)]
        texts = (_text(", ".join(filter(None, values))) or MISSING for values in swept)
        found += [setting for setting in [Setting(f"sweep.{path}", *texts)] if setting.a != setting.b]
    shared = [{"sweep": {}, **_shared(each.directory)} for each in (a, b)]
    one, other = ({**each, "sweep": _common(each, shared, "sweep")} for each in shared)
    found += differing(one, other)
    resolved = _resolved(a.directory), _resolved(b.directory)
    if all(resolved):
        # What only one of them has is named among the trials.
        one, other = ({key: _common(each, resolved, key) for key in SECTIONS} for each in resolved)
        found += differing(one, other)
    else:
        found += _methods(a, b)
    versions = [manifest.read(each.directory).get("versions", {}) for each in (a, b)]
    return found + differing({"versions": versions[0]}, {"versions": versions[1]})


def differing(a: Any, b: Any, path: str = "") -> list[Setting]:
    """Compare two trees of plain data that stand at a path.

    Examples
    --------
    >>> differing({"seed": 1, "time": {"step": 0.1}}, {"seed": 2, "time": {"step": 0.1}})
    [Setting(path='seed', a='1', b='2')]
    >>> [text] = differing({"eps": {"low": -0.8, "high": 0.8}}, {"eps": {"low": -0.4, "high": 0.4}})
    >>> text
    Setting(path='eps', a='+-80%', b='+-40%')
    """
    return _ranges(list(_leaves(a, b, path)))


def _ranges(settings: Sequence[Setting]) -> list[Setting]:
    """Write both ends of a range as one setting, +-40% where they are symmetric."""
    known = {each.path: each for each in settings}
    found = []
    for each in settings:
        stem, _, end = each.path.rpartition(".")
        low, high = known.get(f"{stem}.low"), known.get(f"{stem}.high")
        if end not in ("low", "high") or low is None or high is None or MISSING in (*low, *high):
            found.append(each)
        elif end == "low":
            found.append(Setting(stem, _range(low.a, high.a), _range(low.b, high.b)))
    return found


def _range(low: str, high: str) -> str:
    try:
        ends = float(low), float(high)
    except ValueError:
        return f"{low} to {high}"
    return f"+-{100 * ends[1]:g}%" if ends[0] == -ends[1] else f"{low} to {high}"


def _leaves(a: Any, b: Any, path: str) -> Iterator[Setting]:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            where = f"{path}.{key}" if path else str(key)
            if key in a and key in b:
                yield from _leaves(a[key], b[key], where)
            else:
                yield Setting(where, *(_text(each[key]) if key in each else MISSING for each in (a, b)))
    elif a != b:
        yield Setting(path, _text(a), _text(b))


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _shared(directory: Path) -> dict[str, Any]:
    with Store(directory, writable=False) as store:
        return store.data("shared")


def _resolved(directory: Path) -> dict[str, Any]:
    """Read sections of the resolved configuration; nothing where the file is missing."""
    try:
        tree = plain(load(directory / RESOLVED))
    except ConfigError:
        return {}
    found = {key: tree[key] for key in SECTIONS if isinstance(tree, dict) and key in tree}
    metrics = found.get("metrics", [])
    found["metrics"] = {str(each.get("name", each.get("kind"))): each for each in metrics if isinstance(each, dict)}
    return found


def _common(tree: Mapping[str, Any], both: Sequence[Mapping[str, Any]], key: str) -> Any:
    """Return the entries of a section that both configurations have."""
    sections = [each[key] for each in both if isinstance(each.get(key), Mapping)]
    if key == "statistics" or len(sections) < len(both):
        return tree.get(key)
    return {name: value for name, value in tree[key].items() if all(name in each for each in sections)}


def _methods(a: Results, b: Results) -> Iterator[Setting]:
    """Compare the hashes of the methods at the first point."""
    first, second = a.experiment.points[0].methods, b.experiment.points[0].methods
    for name in (name for name in first if name in second and first[name].definition != second[name].definition):
        yield Setting(f"methods.{name}", first[name].definition[:12], second[name].definition[:12])
