"""rmpc-bench list and describe: the reference manual, read from the code."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits

NOMINAL_TS = 0.1  # [s]; a part itself looks the same for any


@click.command(name="list")
@click.argument("group", required=False, type=click.Choice([*registry.BUILT_IN, "configs"]))
@exits.guarded
def list_(group: str | None) -> int:
    """List the names a configuration may use.

    Without GROUP all of them; `configs` lists the files under configs.
    """
    for name in [group] if group else [*registry.BUILT_IN, "configs"]:
        if not group:
            click.echo(f"{name}:")
        entries = _configs() if name == "configs" else registry.names(name)
        for entry in entries:
            click.echo(entry if group else f"  {entry}")
    return 0


def _configs() -> list[str]:
    return sorted(str(path) for path in Path("configs").rglob("*.yaml"))


@click.command()
@click.argument("name", metavar="[GROUP/]NAME")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw the part, too (.svg .png .pdf).")
@exits.guarded
def describe(name: str, plot: Path | None) -> int:
    """Show what a part is, where it comes from, and which keys it takes."""
    found = _find(name)
    if plot is not None:
        _plot(name, found, plot)
    for number, (group, kind) in enumerate(found):
        if number:
            click.echo()
        _show(group, kind)
    return 0


def _plot(name: str, found: list[tuple[str, str]], file: Path) -> None:
    """Draw a part that has a portrait."""
    from rmpc_bench.report import figures

    if file.suffix.lower() not in figures.FORMATS:
        endings = ", ".join(figures.FORMATS)
        raise click.BadParameter(f"{file}: the ending says the format, one of {endings}", param_hint="'--plot'")
    drawn = [panel for group, kind in found for panel in _portrait(group, kind)]
    if not drawn:
        having = [f"plants/{kind}" for kind in registry.names("plants") if _portrait("plants", kind)]
        known = ", ".join(having) or "no part"
        raise click.BadParameter(f"{name} has no picture (there is one of {known})", param_hint="'--plot'")
    figures.save_as(figures.portrait(drawn), file)
    click.echo(f"written {file}", err=True)


def _portrait(group: str, kind: str) -> tuple[Any, ...]:
    """Panels of a plant with its default parameters; none of one that has no portrait or cannot do without keys."""
    from rmpc_bench.experiment.schema import model_of

    if group != "plants" or any(field.is_required() for field in model_of(group, kind).model_fields.values()):
        return ()
    plant = registry.get(group, kind)(NOMINAL_TS)
    panels: tuple[Any, ...] = getattr(plant, "portrait", tuple)()
    return panels


def _find(name: str) -> list[tuple[str, str]]:
    """Groups and kinds that a name may mean."""
    group, slash, kind = name.rpartition("/")
    if slash and f"{group}s" in registry.BUILT_IN:
        group += "s"
    if slash and group not in registry.BUILT_IN:
        raise click.BadParameter(registry.unknown(group, registry.BUILT_IN, "group"))
    groups = [group] if slash else list(registry.BUILT_IN)
    found = [(each, kind) for each in groups if kind in registry.names(each)]
    if not found:
        known = [each for group in groups for each in registry.names(group)]
        raise click.BadParameter(registry.unknown(kind, known, "part", "rmpc-bench list"))
    return found


def _show(group: str, kind: str) -> None:
    from rmpc_bench.experiment.schema import model_of

    design = registry.get(group, kind)
    click.echo(f"{group}/{kind}")
    module = inspect.getmodule(inspect.unwrap(design))
    for text in (inspect.getdoc(module), inspect.getdoc(design)):
        if text:
            click.echo(f"\n{text.split('Parameters' + chr(10) + '---')[0].rstrip()}")
    meanings = _meanings(inspect.getdoc(design) or "")
    fields = model_of(group, kind).model_fields
    if fields:
        click.echo("\nKeys")
    for name, field in fields.items():
        default = "required" if field.is_required() else f"default {field.default!r}"
        click.echo(f"  {field.alias or name}  ({default})")
        if meanings.get(name):
            click.echo(f"      {meanings[name]}")


def _meanings(doc: str) -> dict[str, str]:
    """Meaning of every parameter in a numpydoc section."""
    meanings: dict[str, str] = {}
    names: list[str] = []
    for line in doc.split("\n"):
        head, colon, text = line.partition(" : ")
        if colon and not line.startswith(" "):
            names = head.split(", ")
            meanings |= dict.fromkeys(names, text)
        elif names and line.startswith("    "):
            meanings |= {name: f"{meanings[name]} {line.strip()}" for name in names}
        elif not line.strip():
            names = []
    return meanings
