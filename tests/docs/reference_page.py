"""docs/reference.md: every key of a configuration from its schema, every option of the command line from click."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import click
from docs.examples_of_keys import EXAMPLES
from docs.markdown import DOCS, code, heading, key_table, page, table, text
from docs.result_files import FILES

from docs import components_page
from rmpc_bench import registry
from rmpc_bench.claims.grammar import FUNCTION_HELP
from rmpc_bench.cli import exits, main
from rmpc_bench.config.sections import SECTIONS
from rmpc_bench.schema.json_schema import MODEL_KEYS, PLANT_KEYS, PLANT_OF, json_schema
from rmpc_bench.schema.manual import KeyEntry, default_text, entry, keys_of_schema

PAGE = DOCS / "reference.md"
INTRODUCTION = """# Reference

Every key of a configuration and every option of the command line. [experiments.md](experiments.md) shows the keys by
example. [components.md](components.md) has the keys of plants, models, estimators, controllers, references, inputs,
noise laws, metrics and figures. To find a key by its name, go to the [index](#index).

An editor with a YAML language server completes and checks keys with the schema that `rmpc-bench schema` prints.
`rmpc-bench check FILE` reports all errors of a configuration at once, each with file, line and column."""
NUMBERS = """A number may be written as a quantity: `2*pi`, `5%`, `sqrt(2)`, `1e-3`, with + - * / and parentheses. Where
a matrix is square by its meaning, a number is that number times the identity and a list is its diagonal; other matrices
are written row by row, `[[1, 0]]`. Matrices also come from files: `{file: system.mat, name: A}`, `.npz`, `.csv`. An
empty cell under *default* means that the key may be left out; its meaning says what holds then."""
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
SHARED = {"plants": {"from": PLANT_OF, **PLANT_KEYS}, "models": MODEL_KEYS}


def generated() -> str:
    """Return the page."""
    schema = json_schema()["properties"]
    parts = [part for title, names in _groups(schema) for part in _group(title, names, schema)]
    return page(
        INTRODUCTION, _contents(schema), NUMBERS, *parts, *_functions(), *_command_line(), *_files(), *_index(schema)
    )


def _groups(schema: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Titles with their keys; a key without a group comes last."""
    groups = [(title, [name for name in names if name in schema]) for title, names in GROUPS.items()]
    placed = {name for _, names in groups for name in names}
    further = [name for name in schema if name not in placed]
    return [*groups, *([(OTHER, further)] if further else [])]


def _contents(schema: Mapping[str, Any]) -> str:
    rows = [
        (title, ", ".join(f"[{name}](#key-{name})" for name in names) + more)
        for title, names in _groups(schema)
        for more in [", [functions](#functions) of claims" if "claims" in names else ""]
    ]
    verbs = ", ".join(f"[{verb}](#verb-{verb})" for verb in _verbs())
    return table(
        ("about", "keys"),
        [*rows, ("Command line", f"{verbs}, [exit codes](#exit-codes), [files](#files) of a results directory")],
    )


def _group(title: str, names: Iterable[str], schema: Mapping[str, Any]) -> list[str]:
    return [f"## {title}", *(part for name in names for part in _section(name, schema[name]))]


def _section(name: str, schema: Mapping[str, Any]) -> list[str]:
    keys = keys_of_section(name, schema)
    meaning = [] if keys == [_plain(name, schema)] else [text(schema["description"])]
    parts = [heading(3, name, "key", name), *meaning, *_details(name)]
    if name in COMPONENTS:
        parts.append(f"Kinds and their keys: [{COMPONENTS[name]}](components/{COMPONENTS[name]}/index.md).")
    parts.append(key_table(keys))
    example = EXAMPLES.get(name, "")
    return [*parts, f"```yaml\n{example.strip()}\n```" if example else ""]


def _details(name: str) -> list[str]:
    """Further paragraphs of the docstring of a section."""
    annotation = SECTIONS[name].annotation if name in SECTIONS else None
    if not (inspect.isclass(annotation) and hasattr(annotation, "__dataclass_fields__")):
        return []
    doc = (inspect.getdoc(annotation) or "").split("Parameters\n---")[0]
    return [text(paragraph) for paragraph in doc.split("\n\n")[1:] if paragraph.strip()]


def keys_of_section(name: str, schema: Mapping[str, Any]) -> Sequence[KeyEntry]:
    """Keys of a section, or the entry of its value."""
    if name == "uncertainty":
        return [*keys_of_schema(schema), *_laws(schema)]
    if name == "methods":
        return [key._replace(keys=()) for key in keys_of_schema(schema["additionalProperties"])]
    if name in COMPONENTS and name != "noise":
        return _component_keys(name)
    return keys_of_schema(schema) or [_plain(name, schema)]


def _component_keys(name: str) -> list[KeyEntry]:
    """Keys that every component of a section may have, beside those of its kind."""
    group = COMPONENTS[name]
    own = KeyEntry(
        "file",
        "PATH.py:NAME",
        "",
        "",
        "a component of a Python file, in place of `kind`; the path is relative to the configuration",
    )
    shared = [] if group not in SHARED else keys_of_schema({"properties": SHARED[group]})
    kind = KeyEntry("kind", "name", None, "", f"one of the {group}, or the name of an installed one")
    return [kind, own, *shared]


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
    about = (
        "A `check` compares terms such as `mse[METHOD]` with `< <= > >= ==` or `a ~ b +- tol`; a chain of comparisons "
    )
    about += "holds if all of them hold. [experiments.md](experiments.md) shows how claims are written."
    rows = []
    for line in FUNCTION_HELP.values():
        usage, _, meaning = line.partition(": ")
        rows.append((code(usage), text(meaning)))
    return [heading(3, "Functions of claims", "functions"), about, table(("function", "meaning"), rows)]


def _verbs() -> list[str]:
    return main.list_commands(click.Context(main))


def _command_line() -> list[str]:
    parts = ["## Command line", "Results go to stdout, messages to stderr. `python -m rmpc_bench` is the same program."]
    for verb in _verbs():
        parts += _verb(verb)
    rows = [(str(number), text(meaning)) for number, meaning in exits.MEANINGS.items()]
    order = "If several apply, the first one in this table is the exit code."
    return [*parts, heading(3, "Exit codes", "exit-codes"), order, table(("code", "meaning"), rows)]


def _files() -> list[str]:
    about = (
        "`run` writes to `results/PAPER/NAME`, or `results/NAME` without a paper. `report` writes all files but the "
    )
    about += "trial store again, without a simulation."
    rows = [(", ".join(map(code, entry.split(", "))), text(meaning)) for entry, meaning in FILES.items()]
    return [heading(2, "Files of a results directory", "files"), about, table(("file", "content"), rows)]


def _verb(verb: str) -> list[str]:
    command = main.get_command(click.Context(main), verb)
    assert command is not None
    # A command keeps the names of its help option from the first context, also for the tests that follow.
    context = click.Context(command, info_name=f"rmpc-bench {verb}", **main.context_settings)
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    options = [param for param in command.get_params(context) if isinstance(param, click.Option)]
    records = [option.get_help_record(context) for option in options if "--help" not in option.opts]
    rows = [(code(" ".join(each[0].split())), text(each[1])) for each in records if each]
    paragraphs = [text(each) for each in inspect.cleandoc(command.help or "").split("\n\n")]
    return [
        heading(3, f"rmpc-bench {verb}", "verb", verb),
        code(usage),
        *paragraphs,
        table(("option", "meaning"), rows),
    ]


def _index(schema: Mapping[str, Any]) -> list[str]:
    """Every key with links to the places where it may stand."""
    found = [(name, f"[top level](#key-{name})") for name in schema]
    for name, section in schema.items():
        named = [
            key for key in keys_of_section(name, section) if not key.name.startswith("dist: ") and key.name != name
        ]
        found += [(key.name, f"[{name}](#key-{name})") for key in named]
    found += components_page.index()
    places: dict[str, list[str]] = {}
    for name, link in sorted(dict.fromkeys(found), key=lambda pair: pair[0].lower()):
        places.setdefault(name, []).append(link)
    rows = [(code(name), _short(links)) for name, links in places.items()]
    return [heading(2, "Index", "index"), table(("key", "where"), rows)]


def _short(links: list[str]) -> str:
    """Links to the places of a key; of a key that a whole group has, only to the group."""
    for group, kinds in registry.BUILT_IN.items():
        own = [link for link in links if f"(components/{group}/" in link]
        if len(own) > 6 and len(own) > len(kinds) // 2:
            links = [*(link for link in links if link not in own), f"[most {group}](components/{group}/index.md)"]
    return ", ".join(links)
