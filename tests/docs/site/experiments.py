"""Pages of the shipped experiments, of the papers they belong to, and the gallery, from what git keeps."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from docs.markdown import DOCS, ROOT, block, kept_figures, table, text
from docs.site.pages import Site, sections

from docs import reproductions_page as papers
from rmpc_bench import registry

Experiment = papers.Configuration
N_ROWS = 40  # comparisons on a page
OF_SUITE = "What suite-1 can say"  # section of docs/suite.md about results, not about use


def write(site: Site) -> None:
    """Add the pages below experiments/, and the guide of the suite."""
    (_, introduction), *_ = sections((DOCS / "reproductions.md").read_text(encoding="utf-8"))
    site.add("experiments/reproductions.md", introduction, "reproductions.md")
    site.lead("reproductions.md", "", "experiments/reproductions.md")
    groups = shipped()
    for group, found in groups.items():
        for each in found:
            path = f"experiments/{name_of(group, each)}.md"
            site.add(path, experiment_text(name_of(group, each), each), "reproductions.md", linked=False)
            site.titles[path] = each.name
        if group in papers.GROUPS:
            parts = [re.sub("^###", "##", part) for part in papers.group_parts(group)[:-1]]
            parts = [f"# {papers.GROUPS[group][0]}", *parts, "## Experiments", cards(group, found, with_titles=True)]
            site.add(f"experiments/{group}/index.md", "\n\n".join(parts), "reproductions.md")
            site.lead("reproductions.md", group, f"experiments/{group}/index.md")
    _suite(site)
    site.add("experiments/index.md", gallery(groups), "reproductions.md", linked=False)


def shipped() -> dict[str, list[Experiment]]:
    """Folder of configs/ -> its configurations by name; "" has those without a folder."""
    folders = {path.parent.name for path in (ROOT / "configs").glob("*/*.yaml")}
    names = [*papers.GROUPS, *sorted(folders - {*papers.GROUPS})]
    found = {name: sorted(papers.configurations(name), key=lambda each: each.name) for name in names}
    return {"": [papers.configuration(path) for path in sorted((ROOT / "configs").glob("*.yaml"))], **found}


def name_of(group: str, experiment: Experiment) -> str:
    """Name for `rmpc-bench run`; a configuration without a folder has the group ""."""
    return f"{group}/{experiment.name}".strip("/")


def experiment_text(name: str, experiment: Experiment) -> str:
    """Title, summary, figure, command, results, claims and configuration of an experiment."""
    data, picture = experiment.data, _picture(experiment)
    parts = [
        f"# {name}",
        f"{text(data['title'])}.",
        text(data.get("summary", "")),
        f"![{Path(picture).stem}](../{picture})" if picture else "",
        block("console", f"$ rmpc-bench run {name}"),
        *results_parts(comparisons(experiment.results)),
        *_claims(experiment),
        "## Configuration",
        block("yaml", experiment.path.read_text(encoding="utf-8").strip()),
    ]
    return "\n\n".join(filter(None, parts))


def _claims(experiment: Experiment) -> list[str]:
    """Claims with their numbers, by kind."""
    parts = ["## Claims", "[Findings explained](/experiments/reproductions.md)."] if experiment.claims else []
    for kind, title in papers.TITLES.items():
        found = [part for claim in experiment.claims if claim["kind"] == kind for part in papers.claim_parts(claim)]
        parts += [f"### {title}", *found] if found else []
    return parts


def comparisons(results: Path) -> list[dict[str, str]]:
    """Kept comparisons of a directory that have a verdict."""
    path = results / "comparisons.csv"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [row for row in csv.DictReader(lines) if row["verdict"]]


def results_parts(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Table of the first comparisons, point by point: change with its interval, runs won, lost and tied, verdict."""
    if not rows:
        return []
    axes, metrics = _axes(rows), sorted({row["metric"] for row in rows})
    adjusted, several = any(row.get("adjusted_form") for row in rows), ["metric"] * (len(metrics) > 1)
    lines = []
    for row, before in zip(rows[:N_ROWS], [{}, *rows], strict=False):
        told = axes if all(row[key] == before.get(key) for key in axes) else []
        cells = [text(row[key]) * (key not in told) for key in (*axes, "method", *several)]
        plain = [_change(row, row["average"]) if row.get("adjusted_form") else ""] if adjusted else []
        cells += [_change(row), *plain, text(f"{row['won']}/{row['lost']}/{row['tied']}")]
        lines.append((*cells, text(row["verdict"].replace("-size", ", size").replace("-", " "))))
    average = " or ".join(sorted({row["average"] for row in rows} - {""}))
    heads = (
        *map(text, axes),
        "method",
        *several,
        "change [%]",
        *["not adjusted"] * adjusted,
        "won/lost/tied",
        "verdict",
    )
    about = f"Change of {', '.join(metrics)} against {', '.join(sorted({row['baseline'] for row in rows}))}"
    more = f"The first {N_ROWS} of {len(rows)} comparisons." * (len(rows) > N_ROWS)
    return ["## Results", f"{text(about)}{f' ({text(average)})' if average else ''}.", table(heads, lines), more]


def _axes(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Columns that tell the points of a sweep apart; the names of the points come first."""

    def points(axes: Sequence[str]) -> int:
        return len({tuple(row[key] for key in axes) for row in rows})

    found: list[str] = []
    for key in sorted(itertools.takewhile(lambda key: key != "method", rows[0]), key=lambda key: key != "name"):
        found += [key] * (points([*found, key]) > points(found))
    return found


def _change(row: Mapping[str, str], average: str = "") -> str:
    """Change with its interval, or the difference where a change has no sense; of a plain average if one is given."""
    names = ("change_pct", "ci_low", "ci_high")
    if average or row["average"] == "difference":
        stem = average or "difference"
        names = (stem if stem == "difference" else f"{stem}_pct", f"{stem}_low", f"{stem}_high")
    value, low, high = (f"{float(row[name]):.4g}" if row[name] else "" for name in names)
    return f"{value} \\[{low}, {high}\\]{' (difference)' * (row['average'] == 'difference')}" if value else ""


def _picture(experiment: Experiment) -> str:
    """Figure that git keeps."""
    place = f"{experiment.results.relative_to(ROOT).as_posix()}/"
    return next((path for path in kept_figures() if path.startswith(place)), "")


def cards(group: str, found: Sequence[Experiment], *, with_titles: bool = False) -> str:
    """A card per experiment."""
    paths = [f"/experiments/{name_of(group, each)}.md" for each in found]
    words = [text(each.data["title"]) * with_titles for each in found]
    return _grid(zip(paths, [each.name for each in found], map(_picture, found), words, strict=True))


def _grid(entries: Iterable[tuple[str, str, str, str]]) -> str:
    """Cards from link, name, picture and words."""
    made = []
    for link, name, picture, words in entries:
        image = f"[![](../{picture}){{ loading=lazy }}]({link})" if picture else ""
        inner = "\n\n".join(filter(None, (image, f"[**{name}**]({link})", words)))
        made.append(f'<div class="card" markdown>\n{inner}\n</div>')
    return "\n".join(['<div class="grid" markdown>', *made, "</div>"])


def figure_kinds() -> dict[str, str]:
    """Kind of figure -> the smallest kept picture of it, "" for none."""
    found = {}
    for kind in sorted(registry.BUILT_IN["figures"]):
        kept = [path for path in kept_figures() if path.endswith(f"/{kind}.svg") and (ROOT / path).exists()]
        found[kind] = min(kept, key=lambda path: (ROOT / path).stat().st_size, default="")
    return found


def gallery(groups: Mapping[str, Sequence[Experiment]]) -> str:
    """Every kind of figure and every shipped experiment."""
    kinds = ((f"/components/figures/{kind}.md", kind, path, "") for kind, path in figure_kinds().items())
    parts = ["# Gallery", "Kinds of figures and shipped experiments.", "## Kinds of figures", _grid(kinds)]
    for group, found in groups.items():
        title = papers.GROUPS[group][0] if group in papers.GROUPS else group.capitalize() or "First comparison"
        link = f"[{title}](/experiments/{group}/index.md)" if group else title
        parts += [f"## {link}", cards(group, found)]
    return "\n\n".join(parts)


def _suite(site: Site) -> None:
    """Divide docs/suite.md into the guide and the results of suite-1."""
    parts = sections((DOCS / "suite.md").read_text(encoding="utf-8"))
    guide, results = ("".join(part for title, part in parts if (title == OF_SUITE) is own) for own in (False, True))
    site.add("how-to/suite.md", guide, "suite.md")
    site.add("experiments/suite/index.md", re.sub("^##", "#", results, flags=re.MULTILINE), "suite.md")
    site.lead("suite.md", "", "how-to/suite.md")
