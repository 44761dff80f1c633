"""rmpc-bench report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.typed_files import TypedPath
from rmpc_bench.types.result_layout import DEFAULT_FORMATS

if TYPE_CHECKING:
    from rmpc_bench.publishing.pages import KeptClaims, Publication

OPTIONS = {"metrics": "--metric"}
"""Key of the section `report` -> its option, where that is not the key itself."""


class Names(click.ParamType[list[str]]):
    """Names with commas between them."""

    name = "names"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> list[str]:
        """Return the names without blanks around them."""
        return value if isinstance(value, list) else [name.strip() for name in str(value).split(",") if name.strip()]


@click.command()
@click.argument("directories", nargs=-1, required=True, type=TypedPath(exists=True, file_okay=False))
@click.option("--to", type=TypedPath(file_okay=False), help="Directory to write to.  [default: DIR]")
@click.option("--width", metavar="LENGTH", help="Width of all figures: 252pt, 88mm, 8.8cm, 3.5in (72.27 pt = 1 in).")
@click.option(
    "--metric", "metrics", type=Names(), metavar="M,..", help="Metrics of the tables; figures show the first."
)
@click.option("--order", type=Names(), metavar="A,B,..", help="Methods to show, in this order.")
@click.option(
    "--columns", type=Names(), metavar="C,..", help="Columns of the LaTeX tables, such as mean,change,counts."
)
@click.option("--style", metavar="STYLE", help="bench (screen) or paper (printed column).")
@click.option("--font", metavar="FONT", help="dejavu, stix or times.")
@click.option(
    "--format", type=Names(), metavar="F,..", help=f"Formats of figures.  [default: {','.join(DEFAULT_FORMATS)}]"
)
@exits.guarded
def report(directories: tuple[Path, ...], to: Path | None, **choices: Any) -> int:
    """Write pages, tables and figures again from stored trials; nothing is simulated.

    The options replace the section `report` of the configuration.  With --to nothing in DIR changes; several
    directories are then written to --to/PAPER/NAME, with an index of their pages in --to/index.html.
    """
    from rmpc_bench.publishing.publish import choose, publish
    from rmpc_bench.replaced_file import inside
    from rmpc_bench.results.results import load_results

    several = to is not None and len(directories) > 1
    kept = _kept_claims(directories) if several else {}
    stored = [directory for directory in directories if directory not in kept]
    places = _places(stored, to, choices, several=several)
    code, index = 0, to / "index.html" if several and to is not None else None
    published: dict[Path, Publication | KeptClaims] = {**kept}
    for directory, place in zip(stored, places, strict=True):
        with inside(to or directory):
            written = publish(choose(load_results(directory), **choices), to=place, index=index)
        exits.show(written)
        code = max(code, exits.code_of(written, strict=False))
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
