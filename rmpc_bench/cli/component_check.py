"""`rmpc-bench check --component`: the conformance checks of one component of the user."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.received.consent import NO_CODE

if TYPE_CHECKING:
    from rmpc_bench.conformance.linear_system import LinearSystem


def check_component(component: str, keys: str | None, model: str | None, group: str | None, seconds: float) -> int:
    """Check a component and print the table; the exit code is 1 where a check of the class `error` fails.

    Parameters
    ----------
    component : ``PATH.py:NAME`` or a name of the registry
    keys : YAML mapping of its keys
    model : a configuration, or the YAML mapping of a model
    group : singular name of the group; found from the component unless given
    seconds : time limit of one check
    """
    from rmpc_bench.components.reference import split_reference
    from rmpc_bench.config_file.tree import Map
    from rmpc_bench.config_file.yaml import parse
    from rmpc_bench.conformance.subject import subject_of
    from rmpc_bench.conformance.supervisor import check_subject
    from rmpc_bench.types import DesignError

    parts = split_reference(component)
    if parts is not None and os.environ.get(NO_CODE) == "1":
        raise click.UsageError(f"{NO_CODE}=1 refuses all Python files")
    if parts is not None and not Path(parts[0]).is_file():
        raise click.UsageError(f"there is no file {parts[0]}")
    given = None if keys is None else parse(keys, "--keys")
    if given is not None and not isinstance(given, Map):
        raise click.UsageError("--keys must be a YAML mapping, such as '{c: 0.1}'")
    try:
        subject = subject_of(component, f"{group}s" if group else "", given, written=given is not None)
        system = None if model is None else _system(model)
    except DesignError as error:
        raise click.UsageError(str(error)) from None
    report = check_subject(subject, system=system, seconds=seconds)
    click.echo(str(report))
    return 0 if report.passed else 1


def _system(text: str) -> LinearSystem:
    """Return the linear system of a configuration or of the YAML mapping of a model.

    Raises
    ------
    ConfigError
        If the configuration or the mapping is not valid.
    DesignError
        If the model is not linear.
    """
    from rmpc_bench.config_file.yaml import parse
    from rmpc_bench.conformance.linear_system import LinearSystem
    from rmpc_bench.types import DesignError

    path = Path(text)
    inline = text.lstrip().startswith("{")
    tree: Any = parse(text, "--model") if inline else None
    model, Ts = _inline(tree) if inline else _of_config(path)
    if not model.is_linear_model:
        raise DesignError("the checks need a linear model; `rmpc-bench check --deep CONFIG` checks with other ones")
    return LinearSystem.of(model, Ts)


def _inline(tree: Any) -> tuple[Any, float]:
    """Build the model of a mapping; its key Ts is the sampling time, 1 s unless given."""
    from rmpc_bench.config_file.component import read_component
    from rmpc_bench.types import ConfigError, Problem

    tree = tree.copy()
    Ts = tree.pop("Ts", 1.0)
    problems: list[Problem] = []
    component = read_component("models", tree, ["model"], problems, mark=tree.mark)
    model = None if component is None else component.build(problems, Ts=float(Ts), n_steps=1)
    if model is None or problems:
        raise ConfigError(problems)
    return model.at(0), float(Ts)


def _of_config(path: Path) -> tuple[Any, float]:
    """Build the model of the first method of a configuration."""
    from rmpc_bench.components.consent import CodeAccess
    from rmpc_bench.config.load import load_config
    from rmpc_bench.config_file.component import read_component
    from rmpc_bench.config_file.tree import Map, Mark
    from rmpc_bench.types import ConfigError, Problem

    config, mark = load_config(path), Mark(str(path), 1, 1)
    experiment, problems = config.experiment, list[Problem]()
    data = Map(next(iter(config.methods.values()))["model"], mark=mark)
    component = read_component("models", data, ["model"], problems, mark=mark, access=CodeAccess.of(path))
    size = {"Ts": experiment.plant.Ts, "n_steps": experiment.n_steps, "plant": experiment.plant}
    model = None if component is None else component.build(problems, **size)
    if model is None or problems:
        raise ConfigError(problems)
    return model.at(0) if model.is_linear_model else model, experiment.plant.Ts
