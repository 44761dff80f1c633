"""rmpc-bench init: the files of a new experiment, with recorded runs of a cart where it has recorded data."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

import click

from rmpc_bench.cli import exits

ESTIMATORS = {"mhe": "MHE", "plain": "Observer"}  # choice of `--estimator` -> class in its template
CONTROLLERS = {"plain": "PI"}  # choice of `--controller` -> class in its template


@click.command()
@click.argument("name", default="tanks")
@click.option(
    "--plant", type=click.Choice(["ode", "data"]), default="ode", show_default=True, help="Form of the plant."
)
@click.option(
    "--estimator",
    type=click.Choice([*ESTIMATORS]),
    default="mhe",
    show_default=True,
    help="A moving-horizon estimator, or an observer of ten lines.",
)
@click.option(
    "--controller",
    type=click.Choice([*CONTROLLERS]),
    default="plain",
    show_default=True,
    help="Form of the controller.",
)
@exits.guarded
def init(name: str, plant: str, estimator: str, controller: str) -> int:
    """Write an experiment with components of your own into the current directory.

    NAME.yaml compares an estimator written for one run with built-in ones on a plant that is a differential equation;
    NAME.py has the components, and test_NAME.py tests them.  With `--plant data` it
    compares estimators on recorded runs, of which it writes a few.  Existing files are never changed.
    """
    if not re.fullmatch(r"[A-Za-z_]\w*", name):
        raise click.BadParameter(f"{name!r} is not a name of a Python module: letters, digits and _", param_hint="NAME")
    texts = starter(name, plant, estimator, controller)
    taken = [file for file in texts if Path(file).exists() and file != ".gitignore"]
    if taken:
        click.echo(f"{', '.join(taken)}: exists already; choose another NAME", err=True)
        return exits.USAGE
    for file, text in texts.items():
        if not Path(file).exists():
            Path(file).parent.mkdir(exist_ok=True)
            Path(file).write_text(text, encoding="utf-8")
            click.echo(f"written {file}", err=True)
    click.echo(f"next    rmpc-bench check --component {name}.py:{ESTIMATORS[estimator]}")
    click.echo(f"        rmpc-bench run {name}.yaml")
    return 0


def starter(name: str, plant: str, estimator: str, controller: str) -> dict[str, str]:
    """Return the files of a new experiment and their texts."""
    # Recorded data need neither a plant, a noise nor a controller.
    own = [f"plant_{plant}", "noise", f"controller_{controller}"] if plant == "ode" else []
    parts = [*own, f"estimator_{estimator}"]
    module = _template("header") + "\n" + "\n\n".join(_template(part) for part in parts)
    types = [word for word in ("Count", "Noise", "Positive") if f": {word} " in module or f"({word})" in module]
    if not types:
        module = module.replace("from rmpc_bench.types import IMPORTS\n", "")
    if "@dataclass" not in module:
        module = module.replace("from dataclasses import dataclass\n\n", "")
    words = {
        "IMPORTS": ", ".join(types),
        "ESTIMATOR": ESTIMATORS[estimator],
        "CONTROLLER": CONTROLLERS[controller],
        "NAME": name,
    }
    texts = {
        f"{name}.yaml": _template(f"config_{plant}"),
        f"{name}.py": module,
        f"test_{name}.py": _template("test" if plant == "ode" else "test_data"),
        ".gitignore": _template("gitignore"),
    }
    for word, value in words.items():
        texts = {file: text.replace(word, value) for file, text in texts.items()}
    return texts if plant == "ode" else texts | recorded_runs(name)


def _template(name: str) -> str:
    return (files("rmpc_bench.cli") / "templates" / f"{name}.txt").read_text(encoding="utf-8")


N_RUNS, N_SAMPLES = 8, 101


def recorded_runs(name: str) -> dict[str, str]:
    """Return the files of the runs and their texts."""
    return {f"{name}_data/run-{run}.csv": _run(run) for run in range(N_RUNS)}


def _run(run: int) -> str:
    # Slow to import, and only needed here.
    import numpy as np

    rng = np.random.Generator(np.random.PCG64(run))
    lines, position, speed = ["time,force,position,true_position,true_speed"], 0.0, 0.0
    for k in range(N_SAMPLES):
        force = 1.0 if (k // 25 + run) % 2 else -1.0
        measured = position + 0.02 * rng.standard_normal()
        lines.append(f"{0.1 * k:.1f},{force:g},{measured:.6f},{position:.6f},{speed:.6f}")
        position += 0.1 * speed + 1e-3 * rng.standard_normal()
        speed += -0.05 * speed + 0.1 * force + 1e-2 * rng.standard_normal()
    return "\n".join(lines) + "\n"
