"""The description of one component: its docstring, its source and its keys."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, get_args

import click

if TYPE_CHECKING:
    from rmpc_bench.components.code import CodeReference

SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)
"""Heading of a section of a numpydoc docstring."""

EVERY_PLANT = """Every plant also has the keys
    perturb, set : factors on nominal values of parameters, or new values, as functions of the uncertain quantities
    bounds : [low, high] of states, such as {x.0: [0, 1], x.1: [null, 5]}; a run that leaves them is `out-of-range`; a
        plant with names takes these, and limits its inputs: {level: [0 m, 0.6 m], pump: [0, 30 ml/s]}
    diverged : magnitude of a state, one number, one per state or by name, beyond which a run is `diverged` (default:
        1e6 times the largest of 1, its initial value and the reference)"""


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
    from rmpc_bench.config.key_meanings import key_meanings, meanings_in
    from rmpc_bench.config.schema import keys_of

    click.echo(f"{group}/{kind}")
    module = inspect.getmodule(inspect.unwrap(design))
    # A class without a docstring of its own inherits that of the base class, which says nothing about it.
    doc = inspect.getdoc(design) or "" if design.__doc__ else ""
    for text in (inspect.getdoc(module), SECTION.split(doc)[0].rstrip()):
        if text:
            click.echo(f"\n{text}")
    meanings = key_meanings(design)
    fields = keys_of(group, kind, design).model_fields
    if fields:
        click.echo("\nKeys")
    nested = _records(design, fields)
    for name, field in fields.items():
        default = "required" if field.is_required() else f"default {_default(field.default)}"
        click.echo(f"  {field.alias or name}  ({default})")
        if meanings.get(name):
            click.echo(f"      {meanings[name]}")
        for record in nested.get(name, ()):
            for key, meaning in meanings_in(inspect.getdoc(record) or "").items():
                click.echo(f"        {key.rstrip('_')} : {meaning}")
    if group == "plants":
        click.echo(f"\n{EVERY_PLANT}")
    sections = SECTION.split(doc)
    for title, text in zip(sections[1::2], sections[2::2], strict=True):
        if title == "Examples":
            click.echo(f"\nExamples\n\n{text.strip()}")


def _default(value: Any) -> str:
    """Show a default as a configuration would write it."""
    from rmpc_bench.config.component import plain_data
    from rmpc_bench.types.sweep_points import value_text

    return value_text(plain_data(value)) if is_dataclass(value) else repr(value)


def _records(design: Any, names: Iterable[str]) -> dict[str, list[type]]:
    """Keys whose value is a mapping with keys of its own -> the dataclasses that say which."""
    from rmpc_bench.config.schema import hints

    parameters = inspect.signature(design).parameters
    annotations = hints(design, {name: parameters[name].annotation for name in names})
    return {
        name: [each for each in _inside(hint) if inspect.isclass(each) and is_dataclass(each)]
        for name, hint in annotations.items()
    }


def _inside(hint: Any) -> list[Any]:
    """An annotation and all those inside it."""
    return [hint, *(each for inner in get_args(hint) for each in _inside(inner))]
