"""Methods that the command line adds to a configuration: ``--add-method 'NAME: {estimator: {kind: .., ..}}'``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rmpc_bench.config_file.key_errors import shown
from rmpc_bench.config_file.reader import parse
from rmpc_bench.config_file.tree import Map, Mark, join, locate, locate_key, plain
from rmpc_bench.config_file.writer import one_line
from rmpc_bench.types import ConfigError, Problem

OPTION = "--add-method"


def read_methods(texts: Sequence[str], problems: list[Problem]) -> Map:
    """Read methods from YAML mappings of the command line, such as ``NAME: {estimator: {kind: kalman}}``.

    The values keep their places in the texts.
    """
    found = Map(mark=Mark(OPTION, 1, 1))
    for text in texts:
        file = f"{OPTION} {text}"
        try:
            tree = parse(text, file)
        except ConfigError as error:
            problems += error.problems
            continue
        if not isinstance(tree, Map) or not tree:
            message = f"must be a mapping such as 'NAME: {{estimator: {{kind: kalman}}}}' (got {shown(tree)})"
            problems.append(Problem(file, 1, 1, "", message))
            continue
        for name, method in tree.items():
            key_mark = locate_key(tree, [name])
            if name in found:
                problems.append(Problem(*key_mark, name, "is added twice"))
            elif not isinstance(method, Map):
                message = f"must be a mapping with an estimator or a controller (got {shown(method)})"
                problems.append(Problem(*locate(tree, [name]), name, message))
            else:
                found.put(name, method, key_mark, locate(tree, [name]))
    return found


def with_methods(tree: Map, added: Map, problems: list[Problem]) -> Map:
    """Add methods from `read_methods` to a tree with overrides and files in place; a taken name is a problem."""
    methods = tree.get("methods")
    if not added or not isinstance(methods, Map):
        return tree
    result, merged = tree.copy(), methods.copy()
    for name, method in added.items():
        key_mark = locate_key(added, [name])
        if name in methods:
            message = "is a method of the configuration already; choose another name"
            problems.append(Problem(*key_mark, join(["methods", name]), message))
        else:
            merged.put(name, method, key_mark, locate(added, [name]))
    result["methods"] = merged
    return result


def texts_of(added: Map) -> Mapping[str, str]:
    """Return name -> the method as the command line takes it, on one line.

    Examples
    --------
    >>> dict(texts_of(read_methods(["A: {estimator: {kind: kalman}}"], [])))
    {'A': 'A: {estimator: {kind: kalman}}'}
    """
    return {name: one_line({name: plain(method)})[1:-1] for name, method in added.items()}
