"""docs/components.md and docs/components/GROUP/KIND.md: a page per component and per group, from its docstrings.

A plant and a design model of one name share the page of the plant.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path

from docs.component_texts import SHARED_BY, module_text, sharing, texts
from docs.examples_of_kinds import examples, users
from docs.markdown import DOCS, anchor, equation_of, kept_figures, key_table, page, table, text

from rmpc_bench import registry
from rmpc_bench.components.designs import registered_design
from rmpc_bench.config_file.tree import SHORT_FORMS
from rmpc_bench.extras import NEEDED_BY, install
from rmpc_bench.schema.manual import Manual, manual_of, shared_keys

INDEX = DOCS / "components.md"
FOLDER = DOCS / "components"
INTRODUCTION = """# Components

What a configuration may name. `rmpc-bench describe GROUP/NAME` shows the same texts on the screen, and
`rmpc-bench list KIND` the names, those of installed packages included. [own-components.md](own-components.md) describes
how to write one, and [reference.md](reference.md) the keys that belong to no component.

Names: x state, u input, y output, r reference, w process noise, v measurement noise, k index of the sample, N number of
control periods, Ts sampling time, ' transposed. [glossary.md](glossary.md) explains the terms. A matrix is
a number (times the identity), a list (its diagonal) or rows; where a list has one number per coordinate, a single
number stands for all.

An example is a whole configuration: save it as `example.yaml`, and `rmpc-bench run example.yaml` runs it."""
PREFERRED = "zenere2018"
"""Paper whose figures are shown where there is a choice."""
ABOUT = {
    "plants": "The true system, `plant: {kind: NAME, ..}`.",
    "models": "The design model of estimators and controllers, `model: {kind: NAME, ..}`, with the covariance "
    "matrices Q (`Q_w`) and R (`R_v`) of process and measurement noise.",
    "estimators": "State estimators (observers), `estimator: {kind: NAME, ..}`, for all methods or in one of them.",
    "controllers": "`controller: {kind: NAME, ..}`, for all methods or in one of them.",
    "references": "What the output follows, `reference: {kind: NAME, ..}`.",
    "inputs": "Inputs in open loop, `input: {kind: NAME, ..}`, in place of a controller.",
    "noises": "Laws of noises and of the initial state, `noise: {measurement: {NAME: {..}}}`. `{sum: [LAW, LAW]}` adds "
    "laws with a random stream each, `{same: {scale: 0.5}}` is the noise of the design model, its deviation halved.",
    "metrics": "One number per run, in the list `metrics`: `NAME`, or `{kind: NAME, name: COLUMN, ..}`.",
    "figures": "Pictures of the results, in the list `figures`: `NAME`, or `{kind: NAME, ..}`.",
}
TITLES = {
    "estimators": "Estimators: Kalman filters, robust filters and moving horizon",
    "models": "Models: the dynamics, and a covariance matrix for each noise (Q and R)",
}
"""Titles with the words for which a search should find them."""
LANGUAGES = {".csv": "csv", ".py": "python"}
WITH_FIGURE = ("plants", "models", "estimators", "controllers", "figures")
JOINT = ("plants", "models")
"""Groups whose components of one name share a page."""


def place(group: str, kind: str) -> str:
    """Return the page of a component, below docs/components."""
    shared = group in JOINT and kind in registry.BUILT_IN[JOINT[0]]
    return f"{JOINT[0] if shared else group}/{kind}.md"


def pages() -> dict[Path, Callable[[], str]]:
    """Return all pages with the functions that make their texts."""
    kinds = {place(group, kind) for group, known in registry.BUILT_IN.items() for kind in known}
    groups = {FOLDER / group / "index.md": partial(_group, group) for group in registry.BUILT_IN}
    return {INDEX: _index, **groups, **{FOLDER / name: partial(_kind, *name[:-3].split("/")) for name in sorted(kinds)}}


def _index() -> str:
    rows = []
    for group, kinds in registry.BUILT_IN.items():
        links = ", ".join(f"[{kind}](components/{place(group, kind)})" for kind in sorted(kinds))
        rows.append((f"[{group}](components/{group}/index.md)", links))
    return page(INTRODUCTION, table(("group", "names"), rows))


def _group(group: str) -> str:
    """The kinds of a group in a line each, and what several of them have in common."""
    kinds = sorted(registry.BUILT_IN[group])
    rows = [(f"[{kind}](../{place(group, kind)})", text(registry.short(group, kind))) for kind in kinds]
    every, several = key_table(shared_keys(group)), _shared_rows(group)
    keys = [f"Every {registry.singular(group)} has these keys:", every] if shared_keys(group) else []
    keys += [f"Several {group} have these keys:", _table(several)] if several else []
    modules = {
        ", ".join(f"`{each}`" for each in sharing(found)): found for found in map(partial(_manual, group), kinds)
    }
    common = [f"- {named}: {module_text(found)}" for named, found in modules.items() if module_text(found)]
    title, kinds_table = TITLES.get(group, group.capitalize()), table(("name", "what it is"), rows)
    return page(f"# {title}", ABOUT[group], kinds_table, "\n".join(common), "## Keys" * bool(keys), *keys)


def _kind(group: str, kind: str) -> str:
    """One component, or a plant and a design model of one name."""
    groups = [each for each in (JOINT if group in JOINT else (group,)) if kind in registry.BUILT_IN[each]]
    common = {*_rows(JOINT[0], kind)} & {*_rows(JOINT[1], kind)} if len(groups) == 2 else set()
    parts = []
    for each in groups:
        title = f"## As a {'plant' if each == 'plants' else 'design model'}"
        parts += [f'<a id="{anchor(each, kind)}"></a>\n\n{title}'] if len(groups) == 2 else []
        parts += _component(each, kind, common)
    both = [row for row in _rows(group, kind) if row in common]
    parts += ["## Keys of both", _table(both)] if both else []
    home = ", ".join(f"[{each.capitalize()}](../{each}/index.md)" for each in groups)
    return page(f"# {kind}", home, *dict.fromkeys(parts), *_in_use([(each, kind) for each in groups]))


def _component(group: str, kind: str, elsewhere: set[str]) -> list[str]:
    """Texts and keys of a component; rows that stand elsewhere on the page are left out."""
    manual = _manual(group, kind)
    examples = [f"```pycon\n{manual.examples}\n```"] if ">>>" in manual.examples else []
    short = [f"Short form: `{group[:-1]}: {{{kind}: ..}}`"] if kind in SHORT_FORMS.get(group, ()) else []
    extra = NEEDED_BY.get((group, kind))
    short += [f"Needs `{install(extra)}`: [libraries.md](../../libraries.md)."] if extra else []
    equation = equation_of(group, kind)
    formula = [f"$$\n{equation}\n$$"] if equation else []
    return [*texts(manual, formula), *short, *_keys(group, kind, elsewhere), *examples]


def _table(rows: Sequence[str]) -> str:
    return "\n".join([key_table(()), *rows])


def _keys(group: str, kind: str, elsewhere: set[str]) -> list[str]:
    """Keys of a component, and the names of those whose rows stand on the page of its group."""
    rows, shared = _rows(group, kind), _shared_rows(group)
    own = [row for row in rows if row not in shared and row not in elsewhere]
    names = [row.split("`")[1] for row in rows if row in shared]
    names = [name for name in names if name.rpartition(".")[0] not in names]
    keys = [_table(own)] if own else []
    if names:
        link = f"[{'Further keys' if keys else 'Keys'}](../{group}/index.md#keys)"
        keys += [f"{link}: {', '.join(f'`{name}`' for name in names)}."]
    return keys or ([] if rows else ["It has no keys."])


def _in_use(components: Sequence[tuple[str, str]]) -> Iterator[str]:
    """An example of each component of a page, the experiments that use them, and a figure of one of them."""
    shown = dict.fromkeys(part for each in components for part in _example(*each))
    yield from ("## Example", *shown)
    configs = list(dict.fromkeys(name for each in components for name in users().get(each, ())))
    if configs:
        yield "Used in " + ", ".join(f"[{name}](../../../configs/{name}.yaml)" for name in configs[:3]) + "."
    group, kind = components[0]
    of_kind = [path for path in kept_figures() if group == "figures" and path.endswith(f"/{kind}.svg")]
    kept = of_kind or [path for name in configs for path in kept_figures() if path.startswith(f"results/{name}/")]
    if kept and group in WITH_FIGURE:
        figure = min(kept, key=lambda path: PREFERRED not in path)
        yield f"![{'/'.join(figure.split('/')[1:3])}](../../../{figure})"


def _example(group: str, kind: str) -> list[str]:
    """Files that name a component, or the command that runs a shipped one."""
    if (group, kind) not in examples():
        return [f"`rmpc-bench run {users()[group, kind][0]} --smoke`"]
    found = examples()[group, kind]
    files = [f"```{LANGUAGES[Path(name).suffix]} {name}\n{content}```" for name, content in found.files.items()]
    return [f"```yaml example.yaml\n{found.text}```", *files]


@cache
def _manual(group: str, kind: str) -> Manual:
    return manual_of(group, kind, registered_design(group, kind))


@cache
def _rows(group: str, kind: str) -> list[str]:
    """Rows of the table of keys; a default that is the name of the kind is written NAME."""
    keys = [key._replace(default="NAME") if key.default == kind else key for key in _manual(group, kind).keys]
    return key_table(keys).split("\n")[2:]


@cache
def _shared_rows(group: str) -> list[str]:
    """Rows that several kinds of a group have, by name; two are enough for a key of one meaning inside a mapping."""
    counts = Counter(row for kind in sorted(registry.BUILT_IN[group]) for row in dict.fromkeys(_rows(group, kind)))
    names = Counter(row.split("|")[1] for row in counts)
    inner = {row for row in counts if names[row.split("|")[1]] == 1 and "." in row.split("|")[1]}
    shared = (row for row, count in counts.items() if count >= SHARED_BY - (row in inner))
    return sorted(shared, key=lambda row: (row.split("`")[1], row))
