"""rmpc-bench list and schema: the names that a configuration may use, and its keys for editors."""

from __future__ import annotations

import json
import shutil
import textwrap
from pathlib import Path

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits, shared_options
from rmpc_bench.config_file.known_files import known_configs
from rmpc_bench.extras import NEEDED_BY, missing_for

WIDTH = 80  # columns of a line at most
MOST_NAME = 26  # columns of a name, which an installed component with a longer one exceeds
_LISTS = (*registry.BUILT_IN, "functions", "configs")


@click.command(name="list")
@click.argument("group", required=False, metavar=f"[{'|'.join(_LISTS)}|FILE.py]")
@click.option("--tag", type=click.Choice(registry.TAGS), help="Only estimators and controllers with this tag.")
@shared_options.import_first
@exits.guarded
def list_(group: str | None, tag: str | None) -> int:
    """List the names a configuration may use, with what each of them is.

    Without an argument the kinds and how many there are of each; `functions` are those of claims, `configs` lists the
    files under configs and the installed configurations.  FILE.py lists the components that a Python file defines.

    Tags of estimators and controllers: the design model that they take (linear, nonlinear or both), and gaps of an
    estimator that predicts where a measurement is missing.  `--tag nonlinear` lists those of both, too.
    """
    if tag and group not in (None, *registry.NONLINEAR):
        raise click.BadParameter(f"only {' and '.join(registry.NONLINEAR)} have tags", param_hint="'--tag'")
    if tag:
        groups = [group] if group else [*registry.NONLINEAR]
        click.echo("\n\n".join("\n".join(_entries(each, tag)) for each in groups))
        return 0
    if group and group.endswith(".py"):
        click.echo("\n".join(_components_of(group)))
        return 0
    if group and group not in _LISTS:
        raise click.BadParameter(registry.unknown(group, _LISTS, "list"))
    click.echo("\n".join(_entries(group) if group else _kinds()))
    return 0


def _kinds() -> list[str]:
    """Name the kinds, and count what there is of each."""
    rows = [(name, len(registry.names(name))) for name in registry.BUILT_IN]
    rows += [("functions", len(_functions())), ("configs", len(known_configs()))]
    return [*(f" {name:12}{n:4}" for name, n in rows), "", " their names: rmpc-bench list KIND"]


def _functions() -> list[str]:
    from rmpc_bench.claims.grammar import FUNCTION_HELP

    return [*FUNCTION_HELP.values()]


def _entries(group: str, tag: str | None = None) -> list[str]:
    """Return a line per name, or per name with a tag; those that need a library that is missing are last."""
    if group == "configs":
        return known_configs()
    if group == "functions":
        return [line for text in _functions() for line in _wrapped(f" {text}", 4)]
    kinds = [kind for kind in registry.names(group) if tag is None or _has(tag, registry.tags(group, kind))]
    lacking = {kind: text for kind in kinds if (text := missing_for(group, kind))}
    rows = [(kind, _text(group, kind)) for kind in kinds if kind not in lacking]
    rows += [(kind, f"needs rmpc-bench[{NEEDED_BY[group, kind]}]") for kind in lacking]
    width = min(max((len(kind) for kind in kinds), default=0) + 2, MOST_NAME)
    names = [f" {kind:{width}}{_tags(group, kind)}" for kind, _ in rows]
    lines = [f"{name}{text}" for name, (_, text) in zip(names, rows, strict=True)]
    head = f"{group}   (design model; gaps: predicts where a measurement is missing)"
    head = head if group == "estimators" else f"{group}   (design model)" if group == "controllers" else group
    return [head, "", *(part for line in lines for part in _wrapped(line, len(names[0])))]


def _has(tag: str, tags: tuple[str, ...]) -> bool:
    """Whether a kind with these tags has a tag; one for both models has that of each."""
    return tag in tags or (tag in ("linear", "nonlinear") and "both" in tags)


def _tags(group: str, kind: str) -> str:
    """Columns of the tags; empty where components have none."""
    model, *gaps = registry.tags(group, kind) or ("",)
    columns = {"estimators": f"{model:7}{gaps[0] if gaps else '':6}", "controllers": f"{model:8}"}
    return columns.get(group, "")


def _wrapped(line: str, indent: int) -> list[str]:
    """Break a line that the terminal, or 80 columns, cannot hold."""
    columns = min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)
    return textwrap.wrap(line, columns, subsequent_indent=" " * indent) if len(line) > columns else [line]


def _text(group: str, kind: str) -> str:
    """What a component is; of an installed one its package and version, and why it cannot be loaded."""
    from rmpc_bench.components.reference import CodeError

    if registry.package_of(group, kind):
        from rmpc_bench.components.designs import registered_design

        try:
            registered_design(group, kind)
        except CodeError as error:
            return str(error)
    return registry.short(group, kind)


def _components_of(file: str) -> list[str]:
    """Return the components that a Python file defines, each with its group."""
    from rmpc_bench.components.consent import CodeAccess, name_files
    from rmpc_bench.components.designs import components_in
    from rmpc_bench.components.loading import module_of
    from rmpc_bench.components.reference import CodeError

    # The user has named this file on the command line, and nothing else.
    access = CodeAccess(Path.cwd(), (Path(file).resolve(),))
    try:
        reference = access.file(file, "")
        access.check(reference)
        name_files([reference])
        found = components_in(module_of(reference.path))
    except CodeError as error:
        raise click.BadParameter(error.line) from None
    return [f"{group}  {file}:{name}" for name, group in found.items()]


@click.command()
@exits.guarded
def schema() -> int:
    """Print the JSON Schema of a configuration.

    An editor with a YAML language server then completes and checks keys.  Write the schema to a file and name it in the
    first line of a configuration: # yaml-language-server: $schema=rmpc-bench.schema.json
    """
    from rmpc_bench.schema.json_schema import json_schema

    click.echo(json.dumps(json_schema(), indent=2))
    return 0
