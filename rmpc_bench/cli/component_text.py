"""The manual of one component on the screen: its docstring, its source and its keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.cli.streams import screen_width
from rmpc_bench.extras import need

if TYPE_CHECKING:
    from rmpc_bench.components.reference import CodeReference
    from rmpc_bench.schema.manual import KeyEntry


def show_own(group: str, reference: CodeReference) -> None:
    """Show a component from a file of the user."""
    from rmpc_bench.components.designs import loaded_design
    from rmpc_bench.components.loading import user_code
    from rmpc_bench.components.reference import CodeError

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
    from rmpc_bench.schema.manual import manual_of, shared_keys
    from rmpc_bench.types.texts import folded

    manual = manual_of(group, kind, design)
    lines = [f"{group}/{kind}  {need(group, kind)}".rstrip()]
    for text in (manual.module, manual.text):
        lines += ["", text] if text else []
    lines += ["", "Keys"] if manual.keys else []
    for key in manual.keys:
        lines += _key_lines(key)
    shared = shared_keys(group)
    lines += ["", f"Every {group.removesuffix('s')} also has the keys"] if shared else []
    lines += [f"    {key.name} : {key.meaning}" for key in shared]
    width = screen_width()
    click.echo("\n".join(folded("\n".join(lines).split("\n"), width)))
    if manual.examples:
        # Code is not broken.
        click.echo(f"\nExamples\n\n{manual.examples}")


def _key_lines(key: KeyEntry) -> list[str]:
    """Write a key with default, type and meaning, and the keys of the mapping that is its value."""
    from rmpc_bench.schema.manual import ANY

    default = "required" if key.default is None else f"default {key.default}" if key.default else "optional"
    kind = "" if key.kind == ANY else f"  {key.kind.replace('`', '')}"
    lines = [f"  {key.name}  ({default}){kind}"] + [f"      {key.meaning}"] * bool(key.meaning)
    return lines + [f"        {inner.name} : {inner.meaning}" for inner in key.keys]
