"""rmpc-bench pack."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.typed_files import TypedPath


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
    from rmpc_bench.extras import install
    from rmpc_bench.packing.pack import pack as pack_results
    from rmpc_bench.received.archive import ArchiveError
    from rmpc_bench.types.result_files import COPIES

    if output is None:
        output = Path(f"{directory.resolve().name or 'results'}.zip")
        if output.exists():
            raise click.UsageError(f"{output} is there already; choose -o FILE")
    try:
        written = pack_results(directory, output, authors=authors, licence=licence)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "rocrate":
            raise
        click.echo(f"pack needs the library rocrate; in a clone, {install('pack')} installs it", err=True)
        return exits.USAGE
    except ArchiveError as error:
        click.echo(str(error), err=True)
        return exits.USAGE
    for text in written.remarks:
        click.echo(text, err=True)
    click.echo(str(written))
    name = shlex.quote(str(output))
    consent = f" --allow-code {name}" if any(each.startswith(f"{COPIES}/") for each in written.files) else ""
    click.echo(f"to check it on any machine: rmpc-bench verify {name}{consent}")
    return 0
