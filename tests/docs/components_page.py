"""docs/components.md: every component with its texts and keys, from docstrings and signatures."""

from __future__ import annotations

import re

from docs.equations import EQUATIONS
from docs.markdown import DOCS, anchor, heading, kept_figures, key_table, page, table, text

from rmpc_bench import registry
from rmpc_bench.components.designs import registered_design
from rmpc_bench.config_file.tree import SHORT_FORMS
from rmpc_bench.extras import NEEDED_BY
from rmpc_bench.schema.manual import Manual, manual_of, shared_keys

PAGE = DOCS / "components.md"
_LABEL = re.compile(r"([A-Z][a-z]+) +(?=\S)")
_INDENT = 8
"""Column at which the text of a labelled paragraph of a module begins."""
_TERM = re.compile(r"(`?[a-z][a-z-]*`?) {2,}(?=\S)")
_PAPER = re.compile(r"\b[a-z]+\d{4}\b")
INTRODUCTION = """# Components

What a configuration may name: plants, design models, estimators, controllers, references, inputs, noise laws, metrics
and figures. `rmpc-bench describe GROUP/NAME` shows the same text on the screen, and `rmpc-bench list KIND` the names,
those of installed packages included. [own-components.md](own-components.md) describes how to write one.

Names: x state, u input, y output, r reference, w process noise, v measurement noise, k index of the sample, N number of
control periods, Ts sampling time, ' transposed. [glossary.md](glossary.md) explains the terms,
[reference.md](reference.md) the keys of a configuration that belong to no component."""
PREFERRED = "zenere2018"
"""Paper whose figures are shown where there is a choice."""
ABOUT = {
    "plants": "The true system, `plant: {kind: NAME, ..}`.",
    "models": "The design model of estimators and controllers, `model: {kind: NAME, ..}`.",
    "estimators": "`estimator: {kind: NAME, ..}`, for all methods or in one of them.",
    "controllers": "`controller: {kind: NAME, ..}`, for all methods or in one of them.",
    "references": "What the output follows, `reference: {kind: NAME, ..}`.",
    "inputs": "Inputs in open loop, `input: {kind: NAME, ..}`, in place of a controller.",
    "noises": "Laws of noises and of the initial state, `noise: {measurement: {NAME: {..}}}`. `{sum: [LAW, LAW]}` adds "
    "laws, `{same: {scale: 0.5}}` is the noise of the design model with half of its standard deviation.",
    "metrics": "One number per run, in the list `metrics`: `NAME`, or `{kind: NAME, name: COLUMN, ..}`.",
    "figures": "Pictures of the results, in the list `figures`: `NAME`, or `{kind: NAME, ..}`.",
}


def generated() -> str:
    """Return the page."""
    return page(INTRODUCTION, _contents(), *(part for group in registry.BUILT_IN for part in _group(group)))


def _contents() -> str:
    rows = []
    for group, kinds in registry.BUILT_IN.items():
        links = ", ".join(f"[{kind}](#{anchor(group, kind)})" for kind in sorted(kinds))
        rows.append((f"[{group}](#{group})", links))
    return table(("group", "names"), rows)


def _group(group: str) -> list[str]:
    title = group.capitalize() if group != "noises" else "Noises"
    shared = shared_keys(group)
    common = [f"Every {registry.singular(group)} has these keys beside its own:", key_table(shared)] if shared else []
    components = [part for kind in sorted(registry.BUILT_IN[group]) for part in _component(group, kind)]
    return [f"## {title}", ABOUT[group], *common, *components]


def _component(group: str, kind: str) -> list[str]:
    manual = manual_of(group, kind, registered_design(group, kind))
    keys = [key_table(manual.keys)] if manual.keys else ["It has no keys."]
    examples = [f"```pycon\n{manual.examples}\n```"] if ">>>" in manual.examples else []
    form = f"`{group[:-1]}: {{{kind}: ..}}`" if kind in SHORT_FORMS.get(group, ()) else ""
    short = [f"Short form: {form}"] if form else []
    extra = NEEDED_BY.get((group, kind))
    short += [f"Needs a library: `pip install '.[{extra}]'`; see [libraries.md](libraries.md)."] if extra else []
    equation = EQUATIONS.get((group, kind), "")
    formula = [f"$$\n{equation.strip()}\n$$"] if equation else []
    return [heading(3, kind, group, kind), *_texts(manual, formula), *_picture(group, kind), *short, *keys, *examples]


def _picture(group: str, kind: str) -> list[str]:
    """A figure of this kind among those that git keeps."""
    kept = [path for path in kept_figures() if group == "figures" and path.endswith(f"/{kind}.svg")]
    shown = min(kept, key=lambda path: (PREFERRED not in path, path), default="")
    experiment = "/".join(shown.split("/")[1:3])
    return [f"![{kind} of {experiment}](../{shown})", f"Figure of {experiment}."] if shown else []


def _texts(manual: Manual, formula: list[str]) -> list[str]:
    """Paragraphs of the docstrings; the labelled ones of the module as a list."""
    title, labelled = _labelled(manual.module)
    items = [_item(label, words) for label, words in labelled]
    labelled_items = "\n".join(items)
    sharing = _sharing(manual)
    if len(sharing) > 1:
        about = f"The kinds {', '.join(f'`{kind}`' for kind in sharing)} share a module, which is described as follows:"
        return [*_paragraphs(manual.text), *formula, about, *_paragraphs(title), labelled_items, *_methods(manual)]
    return [*_paragraphs(title), *_paragraphs(manual.text), *formula, labelled_items, *_methods(manual)]


def _sharing(manual: Manual) -> list[str]:
    """The kinds of the group that are in the same module."""
    kinds = registry.BUILT_IN[manual.group]
    modules = {kind: place.partition(":")[0] for kind, place in kinds.items()}
    return sorted(kind for kind, module in modules.items() if module == modules[manual.kind])


def _item(label: str, words: str) -> str:
    """A labelled paragraph as an item of a list; its terms are items below it, its equations are code."""
    found: list[tuple[str, list[str]]] = [("prose", [])]
    for line in words.split("\n"):
        inner = line.removeprefix(" " * _INDENT)
        term = _TERM.match(inner)
        kind = "equation" if inner.startswith("    ") and found[-1][0] in ("prose", "equation") else "prose"
        if term:
            found.append(("term", [f"`{term[1].strip('`')}` {inner[term.end() :]}"]))
        elif found[-1][0] == kind or (found[-1][0] == "term" and inner.startswith(" ")):
            found[-1][1].append(inner)
        else:
            found.append((kind, [inner]))
    (_, first), *rest = [(kind, lines) for kind, lines in found if "".join(lines).strip() or kind == "prose"]
    parts = [f"- **{label}** {text(' '.join(first))}".rstrip()]
    for kind, lines in rest:
        if kind == "equation":
            inner = "\n".join(f"  {line.strip()}" for line in lines)
            parts.append(f"\n  ```text\n{inner}\n  ```\n")
        else:
            parts.append(f"  {'- ' if kind == 'term' else ''}{text(' '.join(lines))}")
    return "\n".join(parts)


def _labelled(module: str) -> tuple[str, list[tuple[str, str]]]:
    """Split the docstring of a module into its first part and its labelled paragraphs."""
    first, *lines = module.split("\n")
    title, found = [first], []
    for line in lines:
        label = _LABEL.match(line)
        if label and label.end() == _INDENT:
            found.append((label[1], [line[_INDENT:]]))
        elif found and (line.startswith(" ") or not line):
            found[-1][1].append(line)
        else:
            title.append(line)
    return "\n".join(title), [(label, "\n".join(words)) for label, words in found]


def _paragraphs(doc: str) -> list[str]:
    """Paragraphs of a docstring; indented ones are code."""
    found = []
    for paragraph in re.split(r"\n\s*\n", doc.strip()):
        indented = paragraph.startswith("    ")
        found.append(f"```text\n{paragraph}\n```" if indented else text(paragraph))
    return [each for each in found if each]


def _methods(manual: Manual) -> list[str]:
    """Links to the pages of the papers that the module names."""
    papers = dict.fromkeys(_PAPER.findall(manual.module + manual.text))
    links = [f"[{paper}](methods/{paper}.md)" for paper in papers if (DOCS / "methods" / f"{paper}.md").exists()]
    return [f"All equations, assumptions and findings: {', '.join(links)}."] if links else []


def index() -> list[tuple[str, str]]:
    """Return every key of a component with a link to it, for the index of the reference."""
    found = []
    for group, kinds in registry.BUILT_IN.items():
        for kind in kinds:
            manual = manual_of(group, kind, registered_design(group, kind))
            found += [(key.name, f"[{kind}](components.md#{anchor(group, kind)})") for key in manual.keys]
    return found
