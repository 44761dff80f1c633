"""rmpc-bench verify."""

from __future__ import annotations

from pathlib import Path

import click

from rmpc_bench.cli import exits, own_code
from rmpc_bench.cli.run_request import Workers
from rmpc_bench.cli.typed_files import TypedPath


@click.command()
@click.argument("file", type=TypedPath(exists=True, dir_okay=False))
@click.option("--runs", type=click.IntRange(min=1), help="Compute the first runs only.  [default: all]")
@click.option("--claim", default="", metavar="ID", help="Compute what this claim needs: its id, or its number.")
@click.option("--no-run", is_flag=True, help="Compute nothing: check the hashes, and summary.csv with the rows.")
@click.option("-j", "--jobs", type=Workers(), help="Worker processes, or auto.  [default: execution.workers]")
@own_code.allow_code_option
@own_code.import_option
@exits.guarded
def verify(
    file: Path, runs: int | None, claim: str, no_run: bool, jobs: int | None, allow_code: tuple[Path, ...]
) -> int:
    """Compute packed results again on this machine and compare them with the packed ones.

    Makes every table, claim, figure and page again and compares it with the packed file: equal bytes with the versions
    and the machine type of the archive, else numbers up to a relative difference of 1e-9.  Every file that was not
    compared is named.  The exit code is 1 when something differs.  The outcome is appended to the archive, in
    verified_on.json.  Files with code in the archive, FMUs included, run only with --allow-code FILE.
    """
    if no_run and (runs is not None or claim):
        raise click.UsageError("--no-run computes nothing: leave out --runs and --claim")
    from rmpc_bench.execution.progress import choose
    from rmpc_bench.packing.verify import verify as verify_archive
    from rmpc_bench.received.archive import ArchiveError

    try:
        found = verify_archive(
            file,
            runs=runs,
            claim=claim,
            simulate=not no_run,
            allow_code=allow_code,
            jobs=jobs,
            progress=choose("auto"),
        )
    except ArchiveError as error:
        click.echo(str(error), err=True)
        return exits.USAGE
    click.echo(str(found))
    return 0 if found.reproduced else exits.FINDING_DIFFERS
