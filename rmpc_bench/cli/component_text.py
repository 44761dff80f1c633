"""The manual of one component on the screen: its docstring, its source and its keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.extras import need

if TYPE_CHECKING:
    from rmpc_bench.components.code import CodeReference
    from rmpc_bench.config.component_manual import KeyEntry


def show_own(group: str, reference: CodeReference) -> None:
    """Show a component from a file of the user."""
    from rmpc_bench.components.code import CodeError
    from rmpc_bench.components.designs import loaded_design
    from rmpc_bench.components.loading import user_code

    try:
        with user_code(reference.path):
            _show_design(group, reference.text, loaded_design(group, reference))
    except CodeError as error:
        raise click.BadParameter(error.line) from None


def show(group: str, kind: str) -> None:
    """Show a registered component."""
    from rmpc_bench.components.designs import registered_design

    _show_design(group, kind, registered_design(group, kind))


def _show_design(group: str, kind: str, design: Any) -> None:
    from rmpc_bench.config.component_manual import manual_of, shared_keys

    manual = manual_of(group, kind, design)
    click.echo(f"{group}/{kind}  {need(group, kind)}".rstrip())
    for text in (manual.module, manual.text):
        if text:
            click.echo(f"\n{text}")
    if manual.keys:
        click.echo("\nKeys")
    for key in manual.keys:
        _show_key(key)
    shared = shared_keys(group)
    if shared:
        click.echo(f"\nEvery {group.removesuffix('s')} also has the keys")
    for key in shared:
        click.echo(f"    {key.name} : {key.meaning}")
    if manual.examples:
        click.echo(f"\nExamples\n\n{manual.examples}")


def _show_key(key: KeyEntry) -> None:
    """Write a key with default, type and meaning, and the keys of the mapping that is its value."""
    from rmpc_bench.config.schema_words import ANY

    default = "required" if key.default is None else f"default {key.default}" if key.default else "optional"
    kind = "" if key.kind == ANY else f"  {key.kind.replace('`', '')}"
    click.echo(f"  {key.name}  ({default}){kind}")
    if key.meaning:
        click.echo(f"      {key.meaning}")
    for inner in key.keys:
        click.echo(f"        {inner.name} : {inner.meaning}")
