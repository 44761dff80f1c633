"""rmpc-bench status, merge, report and compare: what the directories of results have."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.shared_options import TypedPath
from rmpc_bench.cli.streams import echo_folded, screen_width
from rmpc_bench.types.result_layout import DEFAULT_FORMATS

if TYPE_CHECKING:
    from rmpc_bench.publishing.pages import KeptClaims, Publication

DIRECTORY = TypedPath(exists=True, file_okay=False)
OPTIONS = {"metrics": "--metric"}  # key of the section `report` -> its option, where that is not the key itself


@click.command()
@click.argument("directory", type=DIRECTORY)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@exits.guarded
def status(directory: Path, as_json: bool) -> None:
    """Show how far the computation of an experiment and its shards is.

    Shows finished and failed trials, the rate, the time that is left, and the means of the primary metric so far with
    their standard errors.  It reads progress.json only, so it works on every machine that sees the directory.
    """
    from rmpc_bench.execution.status import read_status

    found = read_status(directory)
    if as_json:
        click.echo(json.dumps(found.to_json(), indent=2))
    else:
        echo_folded(str(found).split("\n"))


@click.command()
@click.argument("directory", type=DIRECTORY)
@click.option("--partial", is_flag=True, help="Join the runs that are there, also while other shards are computed.")
@exits.guarded
def merge(directory: Path, partial: bool) -> int:
    """Join the shards of a directory and write its tables, figures and claims.

    The shards of `rmpc-bench run --shard I/N` must belong to one experiment and be computed by the same code.  They
    stay as they are.  Runs may be missing with --partial only; `rmpc-bench run --missing` computes them.
    """
    from rmpc_bench.execution.merge import merge as join
    from rmpc_bench.publishing.publish import publish
    from rmpc_bench.results.results import read_results

    merged = join(directory, partial=partial, say=lambda text: click.echo(text, err=True))
    click.echo(f"joined: {', '.join(shard.name for shard in merged.shards)}", err=True)
    if merged.missing:
        click.echo("\n".join(["incomplete:", *merged.missing]), err=True)
    return exits.show(publish(read_results(directory)))


def names(value: str) -> list[str]:
    """Split names with commas between them, without the blanks around them."""
    return [name.strip() for name in value.split(",") if name.strip()]


@click.command()
@click.argument("directories", nargs=-1, required=True, type=DIRECTORY)
@click.option("--to", type=TypedPath(file_okay=False), help="Directory to write to.  [default: DIR]")
@click.option("--width", metavar="LENGTH", help="Width of all figures: 252pt, 88mm, 8.8cm, 3.5in (72.27 pt = 1 in).")
@click.option("--metric", "metrics", type=names, metavar="M,..", help="Metrics of the tables; figures show the first.")
@click.option("--order", type=names, metavar="A,B,..", help="Methods to show, in this order.")
@click.option("--columns", type=names, metavar="C,..", help="Columns of the LaTeX tables, such as mean,change,counts.")
@click.option("--style", metavar="STYLE", help="bench (screen) or paper (printed column).")
@click.option("--font", metavar="FONT", help="dejavu, stix or times.")
@click.option(
    "--format", type=names, metavar="F,..", help=f"Formats of figures.  [default: {','.join(DEFAULT_FORMATS)}]"
)
@click.option("--trials/--no-trials", default=None, help="Write trials.csv.  [default: up to 1,000,000 rows]")
@exits.guarded
def report(directories: tuple[Path, ...], to: Path | None, **choices: Any) -> int:
    """Write pages, tables and figures again from stored trials; nothing is simulated.

    The options replace the section `report` of the configuration.  With --to nothing in DIR changes; several
    directories are then written to --to/PAPER/NAME, with an index of their pages in --to/index.html.
    """
    from rmpc_bench.publishing.publish import choose, publish
    from rmpc_bench.replaced_file import inside
    from rmpc_bench.results.results import read_results

    several = to is not None and len(directories) > 1
    kept = _kept_claims(directories) if several else {}
    stored = [directory for directory in directories if directory not in kept]
    places = _places(stored, to, choices, several=several)
    code, index = 0, to / "index.html" if several and to is not None else None
    published: dict[Path, Publication | KeptClaims] = {**kept}
    for directory, place in zip(stored, places, strict=True):
        with inside(to or directory):
            written = publish(choose(read_results(directory), **choices), to=place, index=index)
        code = max(code, exits.show(written))
        published[directory] = written
    if several and to is not None:
        from rmpc_bench.publishing.pages import write_site

        pages = write_site([published[directory] for directory in directories], to)
        click.echo(f"index       {pages[0]}")
    return code


def _kept_claims(directories: tuple[Path, ...]) -> dict[Path, KeptClaims]:
    """Read the kept findings of experiments whose trials are not stored, and say which these are."""
    from rmpc_bench.publishing.pages import kept_claims
    from rmpc_bench.received.store import FILE

    missing = [directory for directory in directories if not (directory / FILE).exists()]
    found = {directory: claims for directory in missing if (claims := kept_claims(directory)) is not None}
    for directory, claims in found.items():
        command = claims.record["experiment"]["command"]
        text = f"{directory}: there is no {FILE}; the index shows its kept findings; `{command}` computes it"
        click.echo(text, err=True)
    return found


def _places(
    directories: Sequence[Path], to: Path | None, choices: dict[str, Any], *, several: bool
) -> list[Path | None]:
    """Return where to write the files of every directory; refuse what is wrong before anything is written."""
    from rmpc_bench.publishing.publish import wrong_choices
    from rmpc_bench.results.results import load_experiment

    experiments = [load_experiment(directory) for directory in directories]
    wrong = dict.fromkeys(pair for experiment in experiments for pair in wrong_choices(experiment, **choices))
    if wrong:
        lines = [f"{OPTIONS.get(key, f'--{key}')}: {message}" for key, message in wrong]
        raise click.UsageError("\n".join(lines))
    if to is None:
        return [None for _ in directories]
    if not several:
        return [to]
    places = [to / (experiment.paper or "") / experiment.name for experiment in experiments]
    for place in places:
        if places.count(place) > 1:
            raise click.UsageError(f"--to: several directories belong to {place}; write them one by one")
    return list(places)


@click.command()
@click.argument("a", type=DIRECTORY)
@click.argument("b", type=DIRECTORY)
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
    from rmpc_bench.results.results import read_results
    from rmpc_bench.types import DesignError

    first, second = read_results(a), read_results(b)
    if method is None:
        found = compare_results(first, second, tolerance=tol or 0.0)
        click.echo(found.text(screen_width(), values=values))
        return 0 if found.equal else exits.FINDING_DIFFERS
    try:
        echo_folded(plain(str(compare_improvements(first, second, method, metric=metric))).split("\n"))
    except DesignError as error:
        raise click.UsageError(str(error)) from None
    return 0
