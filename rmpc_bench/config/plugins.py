"""Python files under `plugins`, whose code registers components, and the line that names all files with code."""

from __future__ import annotations

from rmpc_bench.components.consent import CodeAccess, name_files
from rmpc_bench.components.loading import module_of
from rmpc_bench.components.reference import CodeError, CodeReference
from rmpc_bench.config_file.component import problem_of
from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.tree import Items, Map, Mark, locate
from rmpc_bench.config_file.user_files import named_in
from rmpc_bench.types import ConfigError, Problem

KEY = "plugins"


def load_plugins(tree: Map, access: CodeAccess) -> None:
    """Name the files with code of a configuration on stderr, and run its plugins."""
    problems: list[Problem] = []
    plugins: list[tuple[CodeReference, Mark, str]] = []
    given = tree.get(KEY)
    for number, text in enumerate(given if isinstance(given, Items) else ()):
        mark, path = locate(tree, [KEY, number]), f"{KEY}.{number}"
        if not isinstance(text, str) or not text.endswith(".py"):
            problems.append(
                Problem(*mark, path, f"must be a Python file that registers components (got {shown(text)})")
            )
            continue
        reference = access.file(text, mark.file)
        try:
            access.check(reference)
            plugins.append((reference, mark, path))
        except CodeError as error:
            problems.append(Problem(*mark, path, str(error)))
    name_files([*(reference for reference, _, _ in plugins), *named_in(tree, access)])
    for reference, mark, path in plugins:
        try:
            module_of(reference.path)
        except CodeError as error:
            problems.append(problem_of(error, mark, path))
    if problems:
        raise ConfigError(problems)
