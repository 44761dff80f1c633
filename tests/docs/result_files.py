"""What a run leaves in its directory, for docs/reference.md; a test compares it with what a run writes."""

from __future__ import annotations

FILES: dict[str, str] = {
    "report.html, report.md": "the page: answer, table of the methods, claims; the rest folded",
    "summary.csv": "metrics of every method: mean, standard error, interval, median, quartiles, failed runs",
    "comparisons.csv": "every method against the baseline: change, interval, runs won, lost and tied, verdict",
    "drivers.csv": "share of the variance of the comparison that each uncertain quantity explains",
    "requirements.csv": "runs that meet a requirement, with `statistics: {requirement: ..}`",
    "lost.csv": "share of lost runs with its interval, with `statistics: {lost: ..}`",
    "two-way.csv": "main effects and interactions of two axes of methods, with `methods: {grid: ..}`",
    "tuning.csv": "tuned parameters: range, default, tuned value, regret and rank, with `tune`",
    "tuning.json": "every value that tuning has tried; searches in it are not made again",
    "tuning/": "trials of tuning, and the times that they took",
    "claims.json, claims.md": "statements of a paper with findings, numbers and assumptions; for programs, for readers",
    "tables/": "tables of the comparison as Markdown and LaTeX",
    "figures/": "figures in the formats of `report.format`",
    "trials.csv": "one row per method and run: status and metrics, up to 1,000,000 rows unless asked for; `inf` where "
    "an event did not occur",
    "uncertainty.csv": "one row per run: the values of the uncertain quantities",
    "series.csv": "what is indexed by time: gains, reported covariances, moments; n = 0 means exact",
    "traces.npz": "trajectories of the recorded runs, with `record`",
    "timings.csv": "times of computation of own components",
    "failures/": "one file per failed run, with the command that computes it again",
    "logs/": "what own components print; `workers.txt` has a line for every worker process that has ended early",
    "code/": "copies of own Python files, as they were when the runs were computed",
    "config.yaml, config.resolved.yaml": "the configuration as given, and with every default filled in",
    "manifest.json": "experiment hash, seed, versions, platform and times of the sessions",
    "published.json": "what the derived files were made from; `run` with nothing to do shows them as they are",
    "progress.json": "how far the computation is, replaced every two seconds; `rmpc-bench status` reads it",
    "shards/": "one directory per shard of `rmpc-bench run --shard I/N`, each with a trial store of its own",
    "trials.sqlite": "the trial store: all results, from which every other file is written",
}
"""Files and folders -> content; several names with one meaning are separated by a comma."""


def names() -> list[str]:
    """Return the names of all files and folders."""
    return [name.strip("/") for entry in FILES for name in entry.split(", ")]
