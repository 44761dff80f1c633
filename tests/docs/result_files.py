"""What a run leaves in its directory, for docs/reference.md; a test compares it with what a run writes."""

from __future__ import annotations

FILES: dict[str, str] = {
    "report.html, report.md": "the page: answer, table of the methods, claims",
    "summary.csv": "metrics of every method: mean, standard error, interval, median, quartiles, failed runs",
    "comparisons.csv": "against the baseline: change, interval, runs won, lost and tied, verdict",
    "drivers.csv": "share of the variance that each uncertain quantity explains",
    "requirements.csv": "runs that meet a requirement, with `statistics: {requirement: ..}`",
    "lost.csv": "share of lost runs with its interval, with `statistics: {lost: ..}`",
    "two-way.csv": "main effects and interactions of methods, with `methods: {grid: ..}`",
    "tuning.csv": "range, default, tuned value, regret and rank of parameters, with `tune`",
    "tuning.json": "every value that tuning has tried",
    "tuning/": "trials of tuning and their times",
    "claims.json, claims.md": "statements with findings, numbers and assumptions",
    "tables/": "tables as Markdown and LaTeX",
    "figures/": "figures",
    "trials.csv": "a row per method and run: status and metrics, up to 1,000,000 rows unless asked for; `inf` where "
    "an event did not occur",
    "uncertainty.csv": "one row per run: the values of the uncertain quantities",
    "series.csv": "gains, reported covariances and moments over time; n = 0 means exact",
    "traces.npz": "trajectories of the recorded runs, with `record`",
    "timings.csv": "times of computation of own components",
    "failures/": "one file per failed run, with its command",
    "logs/": "what own components print; `workers.txt` has the worker processes that have ended early",
    "code/": "copies of own Python files",
    "config.yaml, config.resolved.yaml": "the configuration as given, and with every default",
    "manifest.json": "experiment hash, seed, versions, platform and times of the sessions",
    "published.json": "what the derived files were made from",
    "progress.json": "how far the computation is, for `rmpc-bench status`",
    "shards/": "one directory per shard, each with a trial store",
    "trials.sqlite": "the trial store, from which every other file is written",
}
"""Files and folders -> content; several names with one meaning are separated by a comma."""


def names() -> list[str]:
    """Return the names of all files and folders."""
    return [name.strip("/") for entry in FILES for name in entry.split(", ")]
