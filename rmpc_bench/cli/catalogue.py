"""rmpc-bench list and describe: the reference manual, generated from the docstrings and signatures."""

from __future__ import annotations

import difflib
import inspect
import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits, own_code
from rmpc_bench.cli.component_text import show, show_own
from rmpc_bench.cli.streams import screen_width
from rmpc_bench.cli.typed_files import TypedPath
from rmpc_bench.config_file.known_files import SUFFIX, files_of, known_configs, short_names
from rmpc_bench.extras import NEEDED_BY, missing_for

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig

NOMINAL = {"Ts": 0.1, "n_steps": 1}
"""Values for the plot of a plant, which does not depend on them."""
WIDTH = 80
"""Columns of a line at most."""
MOST_NAME = 24
"""Columns of a name, which an installed component with a longer one exceeds."""
NEAR = 0.7
"""Similarity from which on GROUP/NAME is treated as a misspelt configuration and not as an unknown group."""


_LISTS = (*registry.BUILT_IN, "functions", "configs")


@click.command(name="list")
@click.argument("group", required=False, metavar=f"[{'|'.join(_LISTS)}|FILE.py]")
@own_code.import_option
@exits.guarded
def list_(group: str | None) -> int:
    """List the names a configuration may use, with what each of them is.

    Without an argument the kinds and how many there are of each; `functions` are those of claims, `configs` lists the
    files under configs and the installed configurations.  FILE.py lists the components that a Python file defines.
    """
    if group and group.endswith(".py"):
        click.echo("\n".join(own_code.entries(group)))
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
    from rmpc_bench.claims.tree import FUNCTION_HELP

    return [*FUNCTION_HELP.values()]


def _entries(group: str) -> list[str]:
    """Return a line per name; those that need a library that is missing, and those of one paper, are last."""
    if group == "configs":
        return known_configs()
    if group == "functions":
        return [line for text in _functions() for line in _wrapped(f" {text}", 4)]
    kinds = registry.names(group)
    lacking = {kind: text for kind in kinds if (text := missing_for(group, kind))}
    together = [kind for kind in registry.OF_ONE_PAPER.get(group, ()) if kind in kinds]
    usual = [kind for kind in kinds if kind not in lacking and kind not in together]
    nonlinear = registry.NONLINEAR.get(group, frozenset())
    rows = [(kind, "*" if kind in nonlinear else "", _text(group, kind)) for kind in usual]
    if together:
        rows.append((", ".join(together), "", f"of one paper each: rmpc-bench describe {together[0]}"))
    rows += [(kind, "", f"needs rmpc-bench[{NEEDED_BY[group, kind]}]") for kind in lacking]
    width = min(max((len(name) for name, *_ in rows), default=0) + 2, MOST_NAME)
    names = [f" {name:{width}}{f'{mark:2}' if nonlinear else ''}" for name, mark, _ in rows]
    lines = [f"{name}{text}" for name, (_, _, text) in zip(names, rows, strict=True)]
    head = f"{group}   (* takes a nonlinear design model, the others a linear one)" if nonlinear else group
    return [head, "", *(part for line in lines for part in _wrapped(line, len(names[0])))]


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


@click.command()
@click.argument("name", metavar="[GROUP/]NAME|[GROUP/]FILE.py:NAME|CONFIG")
@click.option("--plot", type=TypedPath(), metavar="FILE", help="Also draw the plant (.svg .png .pdf).")
@own_code.allow_code_option
@own_code.import_option
@exits.guarded
def describe(name: str, plot: Path | None, allow_code: tuple[Path, ...]) -> int:
    """Show what a component is, its source, and its keys.

    For a configuration (a file, or its name below configs): the plant and its known properties, the noise, the initial
    state and the methods.
    """
    from rmpc_bench.components.reference import CodeError

    own = own_code.named_component(name)
    if own is not None:
        show_own(*own)
        return 0
    found = _find(name)
    if not found:
        _describe_config(name, plot, allow_code)
        return 0
    if plot is not None:
        _plot(name, [panel for group, kind in found for panel in _panels(group, kind)], plot)
    for number, (group, kind) in enumerate(found):
        if number:
            click.echo()
        try:
            show(group, kind)
        except CodeError as error:
            raise click.BadParameter(f"{group}/{kind}: {error}") from None
    return 0


def _describe_config(name: str, plot: Path | None, allow_code: Sequence[Path]) -> None:
    from rmpc_bench.config.load import load_config

    config = load_config(_config(name), allow_code=allow_code)
    if plot is not None:
        _plot(name, config.experiment.plant.plots(), plot)
    from rmpc_bench.types.texts import folded

    click.echo("\n".join(folded(_config_lines(config), screen_width())))


def _config_lines(config: ExperimentConfig) -> list[str]:
    from rmpc_bench.config_file.tree import kind_of, plain
    from rmpc_bench.config_file.yaml import dump

    plant, resolved = config.experiment.plant, config.first_point
    lines = [str(config.path), config.title or config.name, ""]
    if config.paths:
        lines += [f"at the first of {len(config.points)} points, {config.points[0].title}", ""]
    lines += [f"plant {kind_of(resolved['plant'])}"]
    known = plant.facts()
    known += _noises(config) if known else []
    lines += aligned([row for label, text in known for row in _rows(label, text)])
    for each in config.model_facts:
        lines += ["", each.where, *aligned([row for label, text in each.facts for row in _rows(label, text)])]
    given = dump(plain({key: resolved[key] for key in ("noise", "initial")}))
    methods = [(method.name, _label(config, method.name)) for method in config.experiment.methods]
    return [*lines, "", *given.splitlines(), "", "methods", *aligned(methods)]


def _noises(config: ExperimentConfig) -> list[tuple[str, str]]:
    """Mean and covariance of the noises, where their laws have them in closed form."""
    plant = config.experiment.plant
    laws = config.experiment.scenario.noise_laws(plant.nw, plant.nv)
    if laws is None:
        return []
    mean, cov = laws
    rows = []
    for name, part in (("w", slice(0, plant.nw)), ("v", slice(plant.nw, None))):
        numbers = [" ".join(f"{value:.6g}" for value in row) for row in (mean[part], *cov[part, part])]
        rows.append((f"noise {name}", f"mean {numbers[0]}; covariance {'; '.join(numbers[1:])}"))
    return rows


def _rows(label: str, text: str) -> list[tuple[str, str]]:
    """Lines of a text, the first with its label."""
    return [(label if number == 0 else "", row) for number, row in enumerate(text.split("\n"))]


def aligned(rows: Sequence[tuple[str, str]]) -> list[str]:
    """Return lines of labels and texts, with the texts one below the other."""
    width = 2 + max((len(label) for label, _ in rows), default=0)
    return [f"  {label:{width}}{text}".rstrip() for label, text in rows]


def _label(config: ExperimentConfig, name: str) -> str:
    """Text for tables and figures if it differs from the name; else empty."""
    return config.labels[name] if config.labels[name] != name else ""


def _plot(name: str, drawn: Sequence[Any], file: Path) -> None:
    """Draw the panels of a plant into a file."""
    from rmpc_bench.figures.component_plot import draw_component
    from rmpc_bench.figures.files import FORMATS, save_as

    if file.suffix.lower() not in FORMATS:
        endings = ", ".join(FORMATS)
        raise click.BadParameter(f"{file}: the ending must be one of {endings}", param_hint="'--plot'")
    if not drawn:
        having = [f"plants/{kind}" for kind in registry.names("plants") if _panels("plants", kind)]
        known = ", ".join(having) or "no component"
        raise click.BadParameter(f"{name} has no picture (there is one of {known})", param_hint="'--plot'")
    save_as(draw_component(drawn), file)
    click.echo(f"written {file}", err=True)


def _panels(group: str, kind: str) -> tuple[Any, ...]:
    """Panels of a plant with its default parameters; empty for one without plots or with required keys."""
    from rmpc_bench.config_file.keys import model_of

    if group != "plants" or any(field.is_required() for field in model_of(group, kind).model_fields.values()):
        return ()
    design = registry.get(group, kind)
    asked = inspect.signature(design).parameters
    plant = design(**{name: value for name, value in NOMINAL.items() if name in asked})
    panels: tuple[Any, ...] = plant.plots()
    return panels


def _find(name: str) -> list[tuple[str, str]]:
    """Groups and kinds that a name may mean; empty if it is no component."""
    group, slash, kind = name.rpartition("/")
    groups = [_group(group)] if slash else list(registry.BUILT_IN)
    return [(each, kind) for each in groups if each in registry.BUILT_IN and registry.is_known(each, kind)]


def _group(name: str) -> str:
    """Name a group, which may be given in the singular."""
    return f"{name}s" if f"{name}s" in registry.BUILT_IN else name


def _config(name: str) -> Path:
    """Return the file of a configuration: itself, or by its place below configs, or by its name alone.

    Raises
    ------
    click.BadParameter
        If there is none of this name, or several.
    """
    if name.endswith(SUFFIX) and Path(name).is_file():
        return Path(name)
    found = files_of(name)
    if len(found) > 1:
        raise click.BadParameter(f"{name!r} may be any of {', '.join(map(str, found))}")
    if not found:
        raise click.BadParameter(_unknown(name))
    return found[0]


def _unknown(name: str) -> str:
    """Message for a name that is neither a component nor a configuration, with the nearest known name."""
    group, slash, kind = name.rpartition("/")
    if name.endswith(SUFFIX):
        return registry.unknown(name, known_configs(), "configuration", "rmpc-bench list configs")
    if slash and _group(group) in registry.BUILT_IN:
        return registry.unknown(kind, registry.names(_group(group)), "component", "rmpc-bench list")
    configs = [name for place in known_configs() for name in short_names(place)]
    if slash and difflib.get_close_matches(name, configs, n=1, cutoff=NEAR):
        return registry.unknown(name, configs, "configuration", "rmpc-bench list configs")
    if slash:
        return registry.unknown(group, registry.BUILT_IN, "group")
    components = [each for group in registry.BUILT_IN for each in registry.names(group)]
    return registry.unknown(name, [*components, *configs], "component or configuration", "rmpc-bench list")
