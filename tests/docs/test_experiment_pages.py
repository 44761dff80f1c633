"""Pages of the shipped experiments and the gallery: cards, pictures, claims and numbers are those that git keeps."""

import csv
import re

import pytest
import yaml
from docs.markdown import ROOT, kept_figures, table, text
from docs.reproductions_page import GROUPS, Configuration
from docs.site.__main__ import HERE
from docs.site.experiments import (
    N_ROWS,
    comparisons,
    experiment_text,
    figure_kinds,
    name_of,
    results_parts,
    shipped,
    write,
)
from docs.site.markup import commonmark, math
from docs.site.pages import Site

CONFIGS = {path.relative_to(ROOT / "configs").with_suffix("").as_posix() for path in ROOT.glob("configs/**/*.yaml")}
EXPERIMENTS = {name_of(group, each): each for group, found in shipped().items() for each in found}


@pytest.fixture(scope="module")
def site() -> Site:
    made = Site()
    write(made)
    return made


def test_every_configuration_has_a_page_and_a_card(site: Site):
    assert {*EXPERIMENTS} == CONFIGS and len(CONFIGS) > 83
    linked = set(re.findall(r"\(/experiments/([^)]+)\.md\)", site.texts["experiments/index.md"]))
    assert CONFIGS <= linked and {f"{group}/index" for group in GROUPS} <= linked
    for name in CONFIGS:
        page = site.texts[f"experiments/{name}.md"]
        assert f"$ rmpc-bench run {name}\n" in page and text(EXPERIMENTS[name].data["title"]) in page
        assert (ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8").strip() in page


def test_every_kind_of_figure_has_a_card_with_a_small_picture(site: Site):
    gallery = site.texts["experiments/index.md"]
    for kind, path in figure_kinds().items():
        assert path and (ROOT / path).stat().st_size <= 60_000, kind
        assert f"[![](../{path}){{ loading=lazy }}](/components/figures/{kind}.md)" in gallery


def test_no_picture_is_missing(site: Site):
    """A page shows what git keeps of its experiment; the gallery shows it, too."""
    gallery = site.texts["experiments/index.md"]
    for name in CONFIGS:
        shown = re.findall(r"!\[\w+\]\(\.\./(\S+)\)", site.texts[f"experiments/{name}.md"])
        assert shown == [path for path in kept_figures() if path.startswith(f"results/{name}/")]
        assert all((ROOT / path).is_file() and f"[![](../{path})" in gallery for path in shown), name


def test_every_claim_stands_on_the_page_of_its_experiment_with_its_comparisons(site: Site):
    for name, each in EXPERIMENTS.items():
        page = site.texts[f"experiments/{name}.md"]
        for claim in each.claims:
            assert f"**{text(claim['statement'])}.**" in page
            assert claim["id"] is None or f'<a id="{claim["id"]}"></a>' in page
            assert all(f"{' '.join(number['text'].split())}" in page for number in claim["numbers"]), name
            assert all(f"stated {size['stated']}, computed" in page for size in claim["sizes"]), name


@pytest.mark.long
def test_every_statement_has_one_row_with_its_anchor_on_the_page_of_its_group(site: Site):
    for group in GROUPS:
        page = site.texts[f"experiments/{group}/index.md"]
        places = [(each, claim) for each in shipped()[group] for claim in each.claims]
        ids = {claim["id"] for _, claim in places if claim["id"]}
        assert sorted(re.findall(r'<a id="([^"]+)">', page)) == sorted(f"{group}-{each}" for each in ids)
        assert len(re.findall(r"^\| .* \| \*\*", page, re.MULTILINE)) == len(
            {claim["id"] or (each.name, number) for number, (each, claim) in enumerate(places)}
        )


def cells(line: str) -> list[str]:
    return [cell.strip().replace("\\", "") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


@pytest.mark.parametrize("name", ["zenere2018/fig7", "estimators/outliers", "suite/suite-1", "belda2017/correlation"])
def test_numbers_of_a_page_are_those_of_the_kept_table(site: Site, name: str):
    """Oracle: the table as the standard library reads it."""
    with (ROOT / "results" / name / "comparisons.csv").open(encoding="utf-8") as lines:
        rows = [row for row in csv.DictReader(lines) if row["verdict"]]
    part = site.texts[f"experiments/{name}.md"].partition("## Results")[2].partition("## Claims")[0]
    shown = [cells(line) for line in part.splitlines() if line.startswith("| ")][2:]
    assert len(shown) == min(len(rows), N_ROWS) and (f"of {len(rows)} comparisons" in part) == (len(rows) > N_ROWS)
    for row, (*_, change, runs, verdict) in zip(rows, shown, strict=False):
        keys = ("change_pct", "ci_low", "ci_high")
        keys = keys if row["change_pct"] else ("difference", "difference_low", "difference_high")
        value, low, high = (f"{float(row[key]):.4g}" for key in keys)
        assert change.removesuffix(" (difference)") == f"{value} [{low}, {high}]"
        assert runs == f"{row['won']}/{row['lost']}/{row['tied']}"
        assert verdict.replace(",", "").replace(" ", "-") == row["verdict"]


def test_an_adjusted_change_stands_beside_the_plain_one():
    """Of results/souto2011/benchmarks six rows rest on adjusted averages."""
    rows = comparisons(ROOT / "results" / "souto2011" / "benchmarks")
    shown = [cells(line) for line in "\n".join(results_parts(rows)).splitlines() if line.startswith("| ")]
    column = shown[0].index("not adjusted")
    for row, line in zip(rows, shown[2:], strict=True):
        plain = f"{float(row[row['average'] + '_pct']):.4g} [" if row["adjusted_form"] else ""
        assert line[column].startswith(plain) and bool(line[column]) == bool(row["adjusted_form"])
    assert sum(bool(row["adjusted_form"]) for row in rows) >= 6


def test_results_of_the_suite_and_the_guide_to_it_are_two_pages(site: Site):
    guide, results = site.texts["how-to/suite.md"], site.texts["experiments/suite/index.md"]
    assert "## What suite-1 can say" not in guide and results.startswith("# What suite-1 can say")
    assert "(../experiments/suite/index.md#what-suite-1-can-say)" in site.linked("how-to/suite.md")


HOSTILE = (
    "<script>alert(1)</script> [a](javascript:alert(1)) {{ 7*7 }} `b`{ onclick=alert(1) } | cell | ![](x) ``` ~~~",
    "`` ` <script>alert(1)</script> `` and ` <img src=x onerror=alert(1)> { onclick=alert(1) }",
    "``` # <b onclick=alert(1)>",
)


@pytest.mark.parametrize("words", HOSTILE)
def test_texts_of_a_configuration_are_text(tmp_path, words):
    """Title, summary, statement, results and the file itself may come from anybody; oracle: the parser of the site."""
    markdown = pytest.importorskip("markdown")
    file = tmp_path / "a.yaml"
    file.write_text(f"title: |\n  a\n  ```\n{words}\n\n~~~\n{words}\n", encoding="utf-8")
    claim = {
        "id": '"><script>',
        "source": words,
        "statement": words,
        "kind": "statement of the paper",
        "figures": [words],
    }
    claim |= {"words": words, "joined": "confirmed", "n_runs": 3, "numbers": [], "sizes": []}
    claim["sizes"] = [{"of": "a", "stated": f"\n```\n{words}", "computed": "1"}]
    row = dict.fromkeys(("at", "method", "metric", "baseline", "verdict", "average", "won", "lost", "tied"), words)
    row |= dict.fromkeys(("change_pct", "ci_low", "ci_high"), "1")
    data = {"name": "a", "title": words, "summary": words}
    parts = [experiment_text("a", Configuration(file, data, [claim], ROOT / "results" / "a")), *results_parts([row])]
    parts.append(table(("statement",), [(text(words),)]))
    settings = yaml.unsafe_load((HERE / "mkdocs.yml").read_text("utf-8"))
    extensions = [each if isinstance(each, str) else next(iter(each)) for each in settings["markdown_extensions"]]
    made = markdown.markdown(commonmark(math("\n\n".join(parts))), extensions=extensions)
    tags = re.findall(r"<(\w+)([^<>]*)>", made)
    assert {tag for tag, _ in tags} & {"script", "img", "b"} == set() and "<h2" in made and "<td>" in made
    assert not [about for _, about in tags if re.search(r"\bon\w+=|javascript:", about)]
