"""Options that `rmpc-bench run` and `rmpc-bench suite` have in common."""

from __future__ import annotations

import click

from rmpc_bench.cli.run_request import Workers

jobs = click.option("-j", "--jobs", type=Workers(), help="Worker processes, or auto.  [default: execution.workers]")
n_runs = click.option("--runs", type=click.IntRange(min=1), help="Number of runs; replaces that of the configuration.")
add_method = click.option(
    "--add-method",
    "add_methods",
    multiple=True,
    metavar="'NAME: {...}'",
    help="Add a method to those of the configuration; the directory keeps it.  May be repeated.",
)
smoke = click.option("--smoke", is_flag=True, help="Use the size of the section `smoke`; results go to results/smoke.")
fresh = click.option("--fresh", is_flag=True, help="Rename an existing results directory and compute everything again.")
dry_run = click.option("-n", "--dry-run", is_flag=True, help="Print the number of trials to compute, and stop.")
progress = click.option(
    "--progress",
    type=click.Choice(["auto", "bar", "plain", "json", "none"]),
    default="auto",
    show_default=True,
    help="How progress is shown on stderr: a bar, lines, a JSON object per line, or not at all.",
)
quiet = click.option("-q", "--quiet", is_flag=True, help="Show errors and the result only.")
