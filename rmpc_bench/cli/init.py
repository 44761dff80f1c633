"""rmpc-bench init: the files of a new experiment, with recorded runs of a cart where it has recorded data.

With `--component` it adds a built-in component to the clone of which this file is a part.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path

import click
from click.core import ParameterSource

from rmpc_bench import registry
from rmpc_bench.cli import exits
from rmpc_bench.received.consent import commit_of
from rmpc_bench.replaced_file import replace_text

ROOT = Path(__file__).resolve().parents[2]  # of the clone, if the package is in one
ADDED = ("estimators", "controllers", "metrics")  # groups with a template
LONGEST = 30  # name of a component [characters]; lines with it fit
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
@click.option("--component", metavar="GROUP/NAME", help="Only this: add a built-in component to a clone.")
@click.pass_context
@exits.guarded
def init(context: click.Context, name: str, plant: str, estimator: str, controller: str, component: str | None) -> int:
    """Write an experiment with components of your own into the current directory.

    NAME.yaml compares an estimator written for one run with built-in ones on a plant that is a differential equation;
    NAME.py has the components, and test_NAME.py tests them.  With `--plant data` it
    compares estimators on recorded runs, of which it writes a few.  Existing files are never changed.

    For contributors `--component estimators/my-filter` writes a built-in component into the clone that this program
    belongs to: its module, its tests, and its lines in the lists of kinds.  CONTRIBUTING.md continues from there.
    """
    if component is not None:
        given = [each for each in context.params if context.get_parameter_source(each) is ParameterSource.COMMANDLINE]
        if len(given) > 1:
            raise click.UsageError("--component goes with nothing else")
        return _add(component)
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
    runs = range(N_RUNS if plant == "data" else 0)
    return texts | {f"{name}_data/run-{run}.csv": _recorded_run(run) for run in runs}


def _add(component: str) -> int:
    """Write a built-in component into the clone, or say what is wrong with its name, or all files in the way."""
    group, _, kind = component.partition("/")
    group = group if group in ADDED else f"{group}s"
    wrong = [*_refusals(group, kind)]
    texts = {} if wrong else _additions(group, kind, wrong)
    if wrong:
        click.echo("\n".join([*wrong, "nothing was written"]), err=True)
        return exits.USAGE
    try:
        _write_all(texts)
    except OSError as error:
        click.echo(f"{error}; nothing was written", err=True)
        return exits.CANNOT_WRITE
    click.echo(f"next    write the method into {next(iter(texts))}, and its limit into the docstring")
    click.echo("        make docs lint type")
    click.echo(f"        pytest -k '{' or '.join(dict.fromkeys((kind, _words(kind)['MODULE'], 'every_kind')))}'")
    return 0


def _write_all(texts: Mapping[str, str]) -> None:
    """Write all files; where that fails or is interrupted, all are as they were before."""
    before = {place: place.read_text("utf-8") if place.exists() else None for place in map(ROOT.joinpath, texts)}
    try:
        for place, text in zip(before, texts.values(), strict=True):
            replace_text(place, text)
    except BaseException:
        for place, old in before.items():
            if old is None:
                place.unlink(missing_ok=True)
            elif place.read_text("utf-8") != old:
                replace_text(place, old)
        raise
    for file, old in zip(texts, before.values(), strict=True):
        click.echo(f"{'written' if old is None else 'changed'} {file}", err=True)


def _refusals(group: str, kind: str) -> Iterator[str]:
    """Yield what is wrong with the name of a component, and with the place."""
    sign = "_" if group == "metrics" else "-"
    if group not in ADDED:
        yield f"--component is GROUP/NAME; GROUP is one of {', '.join(ADDED)}, others are written by hand"
    elif registry.is_known(group, kind):
        yield f"{group}/{kind} exists already"
    form = f"[a-z][a-z0-9]*({sign}[a-z0-9]+)*"
    if len(kind) > LONGEST or not re.fullmatch(form, kind) or {kind, kind.title()} & {*keyword.kwlist, "null"}:
        about = f"at most {LONGEST} lower case letters, digits and {sign}, such as my{sign}filter"
        yield f"{kind!r} is not a name of a kind: {about}"
    if not (ROOT / "tests" / "conformance").is_dir():
        yield f"{ROOT} is not a clone of rmpc-bench; `rmpc-bench init NAME` writes components of your own anywhere"
    elif not Path.cwd().is_relative_to(ROOT):
        yield f"the current directory is not in {ROOT}, the clone that this program belongs to"
    elif (commit_of(ROOT) or {}).get("dirty") is True:
        yield f"{ROOT} has uncommitted changes; commit or stash them, so that `git diff` shows what is written"


def _words(kind: str) -> dict[str, str]:
    """Word of a template -> what stands in its place."""
    return {"KIND": kind, "MODULE": kind.replace("-", "_"), "CLASS": re.sub("[-_]", "", kind.title())}


def _additions(group: str, kind: str, wrong: list[str]) -> dict[str, str]:
    """Return the files of a component and those that list it, with their new texts; add what does not fit to `wrong`.

    A template has new files, `== FILE`, and lines to add, `== FILE: LINE BEFORE THEM`.
    """
    template, texts = _template(f"component_{group}"), dict[str, str]()
    if re.search(rf"^from .* import .*\b{_words(kind)['CLASS']}\b", template, re.MULTILINE):
        wrong.append(f"{kind!r}: its module imports {_words(kind)['CLASS']}; choose another name")
    for word, value in _words(kind).items():
        template = template.replace(word, value)
    for part in re.split("^== ", template, flags=re.MULTILINE)[1:]:
        head, _, new = part.partition("\n")
        file, _, before = head.partition(": ")
        place = ROOT / file
        if place.resolve() != ROOT / file:
            wrong.append(f"{file} is a symbolic link, or in one; a clone has none")
        if not before:
            wrong += [f"{file} exists already"] * place.exists()
            texts[file] = new
            continue
        old = texts.get(file) or (place.read_text(encoding="utf-8") if place.is_file() else "")
        lines = old.splitlines(keepends=True)
        found = [n for n, line in enumerate(lines, 1) if line.strip() == before]
        wrong += [f"{file}: expected one line `{before}`, found {len(found)}"] * (len(found) != 1)
        texts[file] = "".join([*lines[: found[0]], new, *lines[found[0] :]]) if found else ""
    return texts


def _template(name: str) -> str:
    return (files("rmpc_bench.cli") / "templates" / f"{name}.txt").read_text(encoding="utf-8")


N_RUNS, N_SAMPLES = 8, 101


def _recorded_run(run: int) -> str:
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
