"""rmpc-bench show."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.shared_options import TypedPath

if TYPE_CHECKING:
    from rmpc_bench.execution.replay import Replay

INDEX = re.compile("[0-9]{1,18}")
SHOWN = 10  # samples of a trace on the screen, the last ones
EXPORTS = (".csv", ".npz", ".mat")
PICTURES = (".svg", ".png", ".pdf")


@click.command()
@click.argument("directory", type=TypedPath(exists=True, file_okay=False))
@click.option("--run", required=True, help="Index of the run, from 0; of runs made elsewhere also its name there.")
@click.option("--method", required=True, help="Name of the method.")
@click.option("--at", multiple=True, metavar="PATH=VALUE", help="Point of a sweep; may be repeated.")
@click.option("--until", type=click.IntRange(min=0), metavar="K", help="Stop after this sample.")
@click.option("--pdb", "debug", is_flag=True, help="Open the debugger in your code: at an exception, or at --until K.")
@click.option("--plot", type=TypedPath(PICTURES), help="Draw the trace into a file.")
@click.option("--export", type=TypedPath(EXPORTS), help="Write the trace: .csv, .npz, .mat.")
@exits.guarded
def show(
    directory: Path,
    run: str,
    method: str,
    at: tuple[str, ...],
    until: int | None,
    debug: bool,
    plot: Path | None,
    export: Path | None,
) -> int:
    """Replay one run bit for bit, alone and with its full trace, from what lies in DIRECTORY.

    It uses the configuration and the copies of your Python files that lie beside the results.  The exit code is 1 if
    the replay differs from what is stored.  Of runs made elsewhere the row of the table is shown.
    """
    from rmpc_bench.execution.replay import replay
    from rmpc_bench.types import DesignError

    point = dict(_pair(text) for text in at)
    is_plain = plot is None and export is None and until is None and not debug
    if is_plain and (lines := _row(directory, method, run, point)):
        click.echo("\n".join(lines))
        return 0
    if not INDEX.fullmatch(run):
        raise click.BadParameter(f"must be an index, from 0 (got {run!r})", param_hint="--run")
    try:
        found = replay(directory, int(run), method, until=until, at=point, call=_debugger(until) if debug else None)
    except DesignError as error:
        raise click.BadParameter(str(error), param_hint=f"--{error.parameter}") from None
    if debug and found.error is not None and not _post_mortem(found.error):
        return 0
    click.echo("\n".join(_lines(found, until)))
    if export is not None:
        _export(found, export)
    if plot is not None:
        _plot(found, plot)
    differs = found.stored_status and (found.differing or found.status != found.stored_status)
    return exits.FINDING_DIFFERS if until is None and differs else 0


def _row(directory: Path, method: str, text: str, point: dict[str, str]) -> list[str]:
    """Return what a table has of a run that was made elsewhere; nothing where it was simulated."""
    from rmpc_bench.results.imported import is_imported
    from rmpc_bench.results.results import read_results
    from rmpc_bench.types.errors import unknown
    from rmpc_bench.types.sweep_points import lies_at

    if not is_imported(directory):
        return []
    trials = read_results(directory).stored
    if method not in trials.methods:
        raise click.BadParameter(unknown(method, trials.methods, "method"), param_hint="--method")
    table = next((each for each in trials.each if lies_at(each.point, point)), None)
    status = {} if table is None else table.statuses(method)
    names = {str(table.run_names[run]): run for run in status} if table is not None and table.run_names else {}
    run = int(text) if INDEX.fullmatch(text) and int(text) in status else names.get(text, -1)
    if table is None or run not in status:
        raise click.BadParameter(f"there is no run {text} of {method} there", param_hint="--run")
    called = f", {table.run_names[run]} in the table," if names else ""
    row = next((i for i, each in enumerate(table.quantities.get("run", ())) if each == run), -1)
    drawn = ", ".join(f"{key} = {x[row]:.6g}" for key, x in table.quantities.items() if row >= 0 and key != "run")
    values = {info.name: table.column(info.name, method)[table.runs == run][0] for info in table.metrics}
    return [
        f"run {run}{called} of {method}{table.title and f' at {table.title}'}: {status[run]}, as the table says",
        *([f"the run that the table calls {text} is --run {names[text]} here"] if names.get(text, run) != run else []),
        *(each.message for each in table.notes[method].failures if each.run == run),
        *([f"parameters  {drawn}"] if drawn else []),
        ", ".join(f"{key} = {value:.6g}" for key, value in values.items()),
    ]


def _pair(text: str) -> tuple[str, str]:
    path, equals, value = text.partition("=")
    if not equals:
        raise click.BadParameter(f"{text!r}: expected PATH=VALUE", param_hint="--at")
    return path.strip(), value.strip()


def _debugger(until: int | None) -> Any:
    """Return what calls the methods of a component: an exception goes to the debugger, and it stops at a sample."""
    import pdb
    from bdb import BdbQuit

    from rmpc_bench.types.run_info import PassedOn, passed_on

    stopped: list[int] = []

    class Debugger(pdb.Pdb):
        def set_quit(self) -> None:
            # The debugger itself would return nothing in place of the answer.
            raise PassedOn(BdbQuit())

    def stopping(role: str, k: int | None, function: Callable[..., Any], values: Sequence[Any]) -> Any:
        if k != until or stopped:
            return passed_on(role, k, function, values)
        stopped.append(1)
        return Debugger(nosigint=True).runcall(function, *values)

    return passed_on if until is None else stopping


def _post_mortem(error: BaseException) -> bool:
    """Open the debugger in the innermost frame of the user's code; False if the user has left it before."""
    import pdb
    from bdb import BdbQuit

    from rmpc_bench.components.user_code import user_entry

    if isinstance(error, BdbQuit):
        return False
    pdb.post_mortem(user_entry(error))
    return True


def _lines(found: Replay, until: int | None) -> list[str]:
    where = f" at {found.point}" if found.point else ""
    lines = [f"run {found.run} of {found.method}{where}: {found.status}"]
    failure, unit = found.failure, found.units["t"]
    if failure is not None:
        at = "" if failure.k is None else f" at k = {failure.k}, t = {found.Ts * failure.k:g} {unit}"
        lines += [f"{failure.component}{at}: {failure.message}"]
        lines += [failure.trace.rstrip()] if failure.trace else []
    if found.failed_steps:
        counts = ", ".join(f"{n} {word}" for word, n in found.failed_steps.items())
        lines += [f"steps whose optimisation failed, where the fallback was applied: {counts}"]
    if found.uncertainty:
        lines += ["uncertain quantities  " + ", ".join(f"{n} = {v:.6g}" for n, v in found.uncertainty.items())]
    if len(found.signals["x"]):
        frame = found.to_frame()
        names = [name for name in frame if name.split(".")[0] in ("k", "t", "r", "y", "u", "u_command", "x", "x_hat")]
        table = frame[names].tail(SHOWN).to_string(index=False, float_format="{:.6g}".format, na_rep="")
        left = len(frame) - SHOWN
        lines += ["", table, *([f"({left} earlier samples: --export FILE.csv)"] if left > 0 else [])]
    return [*lines, "", *_comparison(found, until)]


def _comparison(found: Replay, until: int | None) -> list[str]:
    """Say whether the replay is what is stored."""
    if until is not None:
        return [f"up to k = {until}; without --until the metrics are compared with the stored ones"]
    if not found.stored_status:
        return ["this run is not stored; there is nothing to compare with"]
    if found.status != found.stored_status:
        return [f"differs: the stored status is {found.stored_status}"]
    if found.differing:
        pairs = found.differing.items()
        return [f"differs: {name} is {here!r} here and {there!r} stored" for name, (here, there) in pairs]
    values = ", ".join(f"{name} = {value:.6g}" for name, value in found.metrics.items())
    return [f"bit for bit as stored: {values}" if values else f"as stored: {found.stored_status}"]


def _export(found: Replay, file: Path) -> None:
    frame = found.to_frame()
    if file.suffix.lower() == ".csv":
        from rmpc_bench.report.point_tables import write_csv

        write_csv(dict(frame.items()), file)
    else:
        arrays = {"k": frame["k"].to_numpy(), "t": frame["t"].to_numpy(), "r": found.r, **found.signals}
        if file.suffix.lower() == ".npz":
            import numpy as np

            np.savez_compressed(file, **arrays)
        else:
            from scipy.io import savemat

            savemat(file, arrays, oned_as="column")
    click.echo(f"written {file}", err=True)


def _plot(found: Replay, file: Path) -> None:
    from rmpc_bench.figures.component_plot import draw_component
    from rmpc_bench.figures.files import save_as
    from rmpc_bench.types import Line, Panel

    frame = found.to_frame()
    panels = []
    for signals in (("y", "r"), ("u", "u_command"), ("x", "x_hat")):
        names = [name for name in frame if name.split(".")[0] in signals]
        lines = tuple(Line(str(name), frame["t"].to_numpy(), frame[name].to_numpy(dtype=float)) for name in names)
        unit = found.units.get(signals[0], "")
        panels.append(Panel("", "time [s]", f"{', '.join(signals)}" + (f" [{unit}]" if unit else ""), lines))
    save_as(draw_component(panels), file)
    click.echo(f"written {file}", err=True)
