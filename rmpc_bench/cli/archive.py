"""rmpc-bench pack and verify: an archive of results that others can check."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from rmpc_bench.cli import exits, shared_options
from rmpc_bench.cli.shared_options import TypedPath


@click.command()
@click.argument("directory", type=TypedPath(exists=True, file_okay=False))
@click.option("-o", "--output", type=TypedPath(dir_okay=False), help="The archive.  [default: NAME.zip]")
@click.option("--author", "authors", multiple=True, metavar="NAME", help="Name of an author; may be repeated.")
@click.option("--licence", default="", metavar="SPDX", help="Licence of the results, such as CC-BY-4.0.")
@exits.guarded
def pack(directory: Path, output: Path | None, authors: tuple[str, ...], licence: str) -> int:
    """Pack the results of a directory into one file that others can check with `rmpc-bench verify`.

    The file is a zip archive with RO-Crate metadata.  It has the configuration, the user's files, the rows, the tables,
    figures and claims, the report, and the hash of every file.
    """
    from rmpc_bench.extras import missing
    from rmpc_bench.packing.pack import pack as pack_results
    from rmpc_bench.types.result_layout import COPIES

    if output is None:
        output = Path(f"{directory.resolve().name or 'results'}.zip")
        if output.exists():
            raise click.UsageError(f"{output} is there already; choose -o FILE")
    try:
        written = pack_results(directory, output, authors=authors, licence=licence)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "rocrate":
            raise
        click.echo(missing("pack"), err=True)
        return exits.USAGE
    for text in written.remarks:
        click.echo(text, err=True)
    click.echo(str(written))
    name = shlex.quote(str(output))
    consent = f" --allow-code {name}" if any(each.startswith(f"{COPIES}/") for each in written.files) else ""
    click.echo(f"to check it on any machine: rmpc-bench verify {name}{consent}")
    return 0


@click.command()
@click.argument("file", type=TypedPath(exists=True, dir_okay=False))
@click.option("--runs", type=click.IntRange(min=1), help="Compute the first runs only.  [default: all]")
@click.option("--claim", default="", metavar="ID", help="Compute what this claim needs: its id, or its number.")
@click.option("--no-run", is_flag=True, help="Compute nothing: check the hashes, and summary.csv with the rows.")
@shared_options.jobs
@shared_options.allow_code
@shared_options.import_first
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

    found = verify_archive(
        file, runs=runs, claim=claim, simulate=not no_run, allow_code=allow_code, jobs=jobs, progress=choose("auto")
    )
    click.echo(str(found))
    return 0 if found.reproduced else exits.FINDING_DIFFERS
