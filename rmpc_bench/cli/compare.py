"""rmpc-bench compare."""

from __future__ import annotations

from pathlib import Path

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.streams import screen_width
from rmpc_bench.cli.typed_files import TypedPath

_DIRECTORY = TypedPath(exists=True, file_okay=False)


@click.command()
@click.argument("a", type=_DIRECTORY)
@click.argument("b", type=_DIRECTORY)
@click.option("--tol", type=click.FloatRange(min=0), help="Largest relative difference of equal values.  [default: 0]")
@click.option("--values", is_flag=True, help="List the values, statuses and settings that differ.")
@click.option("--of", "method", metavar="METHOD", help="Compare the improvement of this method on its baseline.")
@click.option("--metric", metavar="METRIC", help="With --of: the metric.  [default: the primary one of A]")
@exits.guarded
def compare(a: Path, b: Path, tol: float | None, values: bool, method: str | None, metric: str | None) -> int:
    """Compare the results of two directories, paired by point of the sweep, method and run.

    Prints the verdicts side by side with the difference of the changes, and the settings that differ; with --values
    also what only one of them has, and the statuses, metrics and findings that differ.  The exit code is 1 when trials
    or findings differ by more than --tol, and 0 when they are equal.

    With --of METHOD: the difference of the improvements of a method on its baseline, A minus B.
    """
    if method is None and metric is not None:
        raise click.UsageError("--metric needs --of METHOD")
    if method is not None and tol is not None:
        raise click.UsageError("--tol compares all trials, and --of one method: give one of them")
    from rmpc_bench.analysis.shown_numbers import plain
    from rmpc_bench.results.compare import compare_improvements, compare_results
    from rmpc_bench.results.results import load_results
    from rmpc_bench.types import DesignError
    from rmpc_bench.types.texts import folded

    first, second = load_results(a), load_results(b)
    if method is None:
        found = compare_results(first, second, tolerance=tol or 0.0)
        click.echo(found.text(screen_width(), values=values))
        return 0 if found.equal else exits.FINDING_DIFFERS
    try:
        text = str(compare_improvements(first, second, method, metric=metric))
        click.echo("\n".join(folded(plain(text).split("\n"), screen_width())))
    except DesignError as error:
        raise click.UsageError(str(error)) from None
    return 0
