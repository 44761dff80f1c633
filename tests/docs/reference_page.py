"""docs/reference.md: keys from the schema, options of the command line from click, and the files of a run."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import click
from docs.examples_of_keys import EXAMPLES
from docs.markdown import DOCS, anchor, code, heading, key_table, page, table, text

from rmpc_bench import registry
from rmpc_bench.claims.grammar import FUNCTION_HELP
from rmpc_bench.cli import exits, main
from rmpc_bench.config.sections import SECTIONS
from rmpc_bench.schema.json_schema import MODEL_KEYS, PLANT_KEYS, PLANT_OF, json_schema
from rmpc_bench.schema.manual import KeyEntry, default_text, entry, keys_of_schema

PAGE = DOCS / "reference.md"
INTRODUCTION = """# Reference

Every key of a configuration and every option of the command line. [experiments.md](experiments.md) shows them by
example, [components.md](components.md) has the keys of components. With the schema that
`rmpc-bench schema` prints an editor completes and checks keys."""
NUMBERS = """A number may be a quantity: `2*pi`, `5%`, `sqrt(2)`, `1e-3`, with + - * / and parentheses. For a square
matrix a number is that number times the identity and a list is its diagonal; others are written row by row,
`[[1, 0]]`, or are in files: `{file: system.mat, name: A}`, `.npz`, `.csv`. A key without a default may be left out.

A component has the key `kind`: one of the kinds of its group, or the name of an installed one. In its place may stand
`file: PATH.py:NAME`, a component of a Python file; the path is relative to the configuration."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Experiment": (
        *("version", "name", "paper", "title", "summary", "extends"),
        *("seed", "runs", "time", "plugins", "requires"),
    ),
    "The true system": ("plant", "uncertainty", "noise", "initial", "reference", "input"),
    "What is compared": ("methods", "model", "estimator", "controller", "sweep"),
    "What is computed and shown": ("metrics", "evaluate", "record", "statistics", "claims", "figures", "report"),
    "Computation": ("execution", "stop", "smoke"),
}
OTHER = "Further keys"
COMPONENTS = {
    **{registry.singular(group): group for group in registry.BUILT_IN},
    **{group: group for group in registry.BUILT_IN},
    "noise": "noises",
}
"""Key of a configuration -> group of its components."""
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
SHARED = {"plants": {"from": PLANT_OF, **PLANT_KEYS}, "models": MODEL_KEYS}


def generated() -> str:
    """Return the page."""
    schema = json_schema()["properties"]
    parts = [part for title, names in _groups(schema) for part in _group(title, names, schema)]
    return page(INTRODUCTION, _contents(schema), NUMBERS, *parts, *_functions(), *_command_line(), *_files())


def _groups(schema: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Titles with their keys; a key without a group comes last."""
    groups = [(title, [name for name in names if name in schema]) for title, names in GROUPS.items()]
    placed = {name for _, names in groups for name in names}
    further = [name for name in schema if name not in placed]
    return [*groups, *([(OTHER, further)] if further else [])]


def _contents(schema: Mapping[str, Any]) -> str:
    links = {title: [f"[{name}](#key-{name})" for name in names] for title, names in _groups(schema)}
    links["What is computed and shown"].append("[functions](#functions) of claims")
    links["Command line"] = [*(f"[{verb}](#verb-{verb})" for verb in _verbs()), "[exit codes](#exit-codes)"]
    return table(("about", "keys"), [(title, ", ".join(each)) for title, each in links.items()])


def _group(title: str, names: Iterable[str], schema: Mapping[str, Any]) -> list[str]:
    """Keys that are no mapping in one table, then a section for each of the others."""
    entries = {name: keys_of_section(name, schema[name]) for name in names}
    single = [name for name, keys in entries.items() if keys == [_plain(name, schema[name])]]
    rows = key_table([entries[name][0] for name in single])
    for name in single:
        rows = rows.replace(f"\n| `{name}` |", f'\n| <a id="{anchor("key", name)}"></a>`{name}` |', 1)
    sections = [_section(name, schema[name], keys) for name, keys in entries.items() if name not in single]
    return [f"## {title}", *([rows, _example(single)] if single else []), *(part for each in sections for part in each)]


def _example(names: Iterable[str]) -> str:
    return "\n".join(["```yaml", *(EXAMPLES[name].strip() for name in names if name in EXAMPLES), "```"])


def _section(name: str, schema: Mapping[str, Any], keys: Sequence[KeyEntry]) -> list[str]:
    meaning = text(schema["description"])
    if name in COMPONENTS:
        meaning += f" [Kinds](components/{COMPONENTS[name]}/index.md)."
    return [heading(3, name, "key", name), meaning, key_table(keys) if keys else "", _example([name])]


def keys_of_section(name: str, schema: Mapping[str, Any]) -> Sequence[KeyEntry]:
    """Keys of a section, or the entry of its value."""
    if name == "uncertainty":
        return [*keys_of_schema(schema), *_laws(schema)]
    if name == "methods":
        return [key._replace(keys=()) for key in keys_of_schema(schema["additionalProperties"])]
    if name in COMPONENTS and name != "noise":
        return keys_of_schema({"properties": SHARED.get(COMPONENTS[name], {})})
    return keys_of_schema(schema) or [_plain(name, schema)]


def _laws(schema: Mapping[str, Any]) -> list[KeyEntry]:
    """Keys of the laws of an uncertain quantity."""
    found = []
    for law in schema["additionalProperties"]["anyOf"]:
        if "properties" not in law:
            continue
        kind, *keys = keys_of_schema(law)
        found.append(kind._replace(name=f"dist: {kind.kind.strip('`')}", kind="law", default=""))
        found += keys
    return found


def _plain(name: str, schema: Mapping[str, Any]) -> KeyEntry:
    """Entry of a key that is no mapping."""
    if name not in SECTIONS:
        return entry(name, dict(schema), default_text(schema.get("default")))
    default = SECTIONS[name].default
    return entry(name, dict(schema), None if default is ... else default_text(default))


def _functions() -> list[str]:
    about = "A `check` compares terms such as `mse[METHOD]` with `< <= > >= ==` or `a ~ b +- tol`."
    rows = []
    for line in FUNCTION_HELP.values():
        usage, _, meaning = line.partition(": ")
        rows.append((code(usage), text(meaning)))
    return [heading(3, "Functions of claims", "functions"), about, table(("function", "meaning"), rows)]


def _verbs() -> list[str]:
    return main.list_commands(click.Context(main))


def _command_line() -> list[str]:
    about = "Results go to stdout, messages to stderr. `rmpc-bench VERB --help` says more."
    parts = ["## Command line", about]
    known: dict[tuple[str, str], str] = {}
    for verb in _verbs():
        parts += _verb(verb, known)
    rows = [(str(number), text(meaning)) for number, meaning in exits.MEANINGS.items()]
    order = "If several apply, the first one in this table is the exit code."
    return [*parts, heading(3, "Exit codes", "exit-codes"), order, table(("code", "meaning"), rows)]


def _files() -> list[str]:
    about = "`run` writes to `results/PAPER/NAME`, or `results/NAME` without a paper."
    rows = [(", ".join(map(code, entry.split(", "))), text(meaning)) for entry, meaning in FILES.items()]
    return [
        heading(2, "Files of a results directory: trials.csv, summary.csv and others", "files"),
        about,
        table(("file", "content"), rows),
    ]


def _verb(verb: str, known: dict[tuple[str, str], str]) -> list[str]:
    """Usage, first paragraph of the help, and options of a verb; those that an earlier one has, too, are named only."""
    command = main.get_command(click.Context(main), verb)
    assert command is not None
    # A command keeps the names of its help option from the first context, also for the tests that follow.
    context = click.Context(command, info_name=f"rmpc-bench {verb}", **main.context_settings)
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    options = [param for param in command.get_params(context) if isinstance(param, click.Option)]
    records = [option.get_help_record(context) for option in options if "--help" not in option.opts]
    found = [(code(" ".join(each[0].split())), text(each[1])) for each in records if each]
    rows = [each for each in found if known.setdefault(each, verb) == verb]
    first = {each: known[each] for each in found if each not in rows}
    also = [
        f"{', '.join(name for (name, _), its in first.items() if its == each)} as of [{each}](#verb-{each})"
        for each in dict.fromkeys(first.values())
    ]
    return [
        heading(3, f"rmpc-bench {verb}", "verb", verb),
        code(usage),
        text(inspect.cleandoc(command.help or "").split("\n\n")[0]),
        table(("option", "meaning"), rows) if rows else "",
        f"Also {'; '.join(also)}." if also else "",
    ]
