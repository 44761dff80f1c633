"""rmpc-bench describe: the manual of a component, from its docstring and signature, or a configured system."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits, shared_options
from rmpc_bench.cli.shared_options import TypedPath
from rmpc_bench.cli.streams import echo_folded
from rmpc_bench.config_file.known_files import SUFFIX, files_of, known_configs, located, short_names
from rmpc_bench.extras import need

if TYPE_CHECKING:
    from rmpc_bench.components.reference import CodeReference
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.schema.manual import KeyEntry


NOMINAL = {"Ts": 0.1, "n_steps": 1}  # values for the plot of a plant, which does not depend on them
NEAR = 0.7  # similarity from which on GROUP/NAME is treated as a misspelt configuration and not as an unknown group


@click.command()
@click.argument("name", metavar="[GROUP/]NAME|[GROUP/]FILE.py:NAME|CONFIG")
@click.option("--plot", type=TypedPath(), metavar="FILE", help="Also draw the plant (.svg .png .pdf).")
@shared_options.allow_code
@shared_options.import_first
@exits.guarded
def describe(name: str, plot: Path | None, allow_code: tuple[Path, ...]) -> int:
    """Show what a component is, its source, and its keys.

    For a configuration (a file, or its name below configs): the plant and its known properties, the noise, the initial
    state and the methods.
    """
    from rmpc_bench.components.designs import registered_design
    from rmpc_bench.components.reference import CodeError

    own = _named_component(name)
    if own is not None:
        _show_own(*own)
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
            _show_design(group, kind, registered_design(group, kind))
        except CodeError as error:
            raise click.BadParameter(f"{group}/{kind}: {error}") from None
    return 0


def _describe_config(name: str, plot: Path | None, allow_code: Sequence[Path]) -> None:
    from rmpc_bench.config.load import load_config

    config = load_config(_config(name), allow_code=allow_code)
    if plot is not None:
        _plot(name, config.experiment.plant.plots(), plot)
    echo_folded([str(located(_config(name))), *_config_lines(config)])


def _config_lines(config: ExperimentConfig) -> list[str]:
    from rmpc_bench.config_file.tree import kind_of, plain
    from rmpc_bench.config_file.yaml import dump

    plant, resolved = config.experiment.plant, config.first_point
    lines = [config.title or config.name, ""]
    if config.paths:
        lines += [f"at the first of {len(config.points)} points, {config.points[0].title}", ""]
    lines += [f"plant {kind_of(resolved['plant'])}"]
    known = plant.facts()
    known += _noises(config) if known else []
    lines += _aligned(known)
    for each in config.model_facts:
        lines += ["", each.where, *_aligned(each.facts)]
    names = [method.name for method in config.experiment.methods]
    given = dump(plain({key: resolved[key] for key in ("noise", "initial")}))
    # A label that is the name itself says nothing.
    labels = [("" if config.labels[name] == name else config.labels[name]) for name in names]
    return [*lines, "", *given.splitlines(), "", "methods", *_aligned([*zip(names, labels, strict=True)])]


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


def _aligned(facts: Sequence[tuple[str, str]]) -> list[str]:
    """Return lines of labels and texts, with the texts one below the other; a text may have several lines."""
    from rmpc_bench.types.texts import in_columns

    rows = [(label if k == 0 else "", line) for label, text in facts for k, line in enumerate(text.split("\n"))]
    return in_columns(rows, indent="  ")


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
    """Return the file of a configuration: itself, or by its place below configs, or by its name alone."""
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


def _named_component(name: str) -> tuple[str, CodeReference] | None:
    """Return group and reference of an argument ``[GROUP/]PATH.py:NAME``, its file loaded; None for any other."""
    from rmpc_bench.components.reference import CodeError, split_reference

    parts = split_reference(name)
    if parts is None:
        return None
    from rmpc_bench.components.consent import CodeAccess
    from rmpc_bench.components.designs import group_of

    group, _, text = name.partition("/")
    group = _group(group)
    if group not in registry.BUILT_IN or Path(parts[0]).is_file():
        group, text = "", name
    # The user has named this file on the command line, and nothing else.
    access = CodeAccess(Path.cwd(), (Path(text.rpartition(":")[0]).resolve(),))
    try:
        reference = access.reference(text, "")
        found = access.load(reference)
    except CodeError as error:
        raise click.BadParameter(error.line) from None
    group = group or group_of(found) or ""
    if not group:
        groups = ", ".join(registry.BUILT_IN)
        raise click.BadParameter(f"{text}: is it one of {groups}? Write it in front: estimators/{text}")
    return group, reference


def _show_own(group: str, reference: CodeReference) -> None:
    """Show a component from a file of the user."""
    from rmpc_bench.components.designs import loaded_design
    from rmpc_bench.components.loading import user_code
    from rmpc_bench.components.reference import CodeError

    try:
        with user_code(reference.path):
            _show_design(group, reference.text, loaded_design(group, reference))
    except CodeError as error:
        raise click.BadParameter(error.line) from None


def _show_design(group: str, kind: str, design: Any) -> None:
    from rmpc_bench.schema.manual import manual_of, shared_keys

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
    echo_folded("\n".join(lines).split("\n"))
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
