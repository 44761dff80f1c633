"""The pages docs/methods: formulas that code hosts render, files and functions that exist."""

import ast
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest
from docs.site.pages import anchors

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "methods").glob("*.md"))
ALL = sorted([*(ROOT / "docs").glob("*.md"), *PAGES])
GENERATED = {"components", "reference", "reproductions"}
"""tests/docs/test_generated_pages.py tests these."""
WRITTEN = [page for page in ALL if page.stem not in GENERATED]
FENCE = re.compile(r"^```(.*?)^```", re.MULTILINE | re.DOTALL)
DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
INLINE = re.compile(r"\$([^$\n]+)\$")
PLACE = re.compile(r"`([a-z_]+(?:/[a-z_]+)*\.py):([A-Za-z_.]+)`")


def read(page: Path) -> str:
    return page.read_text("utf-8")


def outside_code(text: str) -> str:
    """The text without fenced blocks and without `code`, in which a dollar sign is no formula."""
    return re.sub(r"`[^`\n]*`", "", FENCE.sub("", text))


def formulas(text: str) -> tuple[list[str], list[str], list[str]]:
    """Formulas in fences, displayed ones and those in a line."""
    fenced = [block[len("math") :] for block in FENCE.findall(text) if block.startswith("math\n")]
    plain = outside_code(text)
    return fenced, DISPLAY.findall(plain), INLINE.findall(DISPLAY.sub("", plain))


@cache
def defined(file: Path) -> set[str]:
    """Functions and classes of a module, and methods as `Class.method`."""
    names = set()
    for node in ast.parse(read(file)).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
            names |= {f"{node.name}.{sub.name}" for sub in ast.walk(node) if isinstance(sub, ast.FunctionDef)}
    return names


def test_there_is_a_page_per_paper():
    assert [page.stem for page in PAGES] == ["belda2017", "ma2025", "souto2011", "zenere2017", "zenere2018"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_file_and_function_exists(page):
    places = PLACE.findall(read(page))
    missing = [
        f"{file}:{name}"
        for file, name in places
        if not (ROOT / "rmpc_bench" / file).is_file() or name not in defined(ROOT / "rmpc_bench" / file)
    ]
    assert len(places) >= 6 and missing == []


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_formulas_are_balanced(page):
    """Braces, brackets that grow, environments and dollar signs come in pairs."""
    fenced, displayed, inline = formulas(read(page))
    rest = INLINE.sub("", DISPLAY.sub("", outside_code(read(page))))
    assert "$" not in rest
    for formula in [*fenced, *displayed, *inline]:
        bare = formula.replace(r"\{", "").replace(r"\}", "")
        depth = 0
        for sign in bare:
            depth += (sign == "{") - (sign == "}")
            assert depth >= 0, formula
        assert depth == 0, formula
        assert len(re.findall(r"\\left\b", formula)) == len(re.findall(r"\\right\b", formula)), formula
        assert re.findall(r"\\begin\{(\w+)\}", formula) == re.findall(r"\\end\{(\w+)\}", formula), formula


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_formulas_survive_markdown(page):
    """Signs that a Markdown parser may take for its own: emphasis, escapes, HTML, the columns of a table."""
    _, displayed, inline = formulas(read(page))
    for formula in [*displayed, *inline]:
        assert not re.search(r"[*<>]|\\[\\{}_#%]|(?<![A-Za-z0-9])_", formula), formula
    assert all(formula == formula.strip() for formula in inline), inline
    for line in outside_code(read(page)).splitlines():
        if line.startswith("|"):
            assert not any("|" in formula for formula in INLINE.findall(line)), line
        # A formula in a line begins after a space or a bracket and ends before a space or punctuation.
        if "$$" not in line:
            for match in INLINE.finditer(line):
                before, after = line[: match.start()][-1:], line[match.end() :][:1]
                assert before in ("", " ", "(", "[") and after in ("", *" .,;:)]?"), match[0]


def compiled(formulas: list[str], folder: Path) -> str:
    """Errors of LaTeX, which stops at none of the formulas."""
    body = "\n".join(f"\\typeout{{FORMULA {i}}}$\\displaystyle {f.strip()}$\n" for i, f in enumerate(formulas))
    # MathJax and KaTeX know gt and lt, which Markdown cannot take for HTML.
    names = "\\newcommand{\\gt}{>}\\newcommand{\\lt}{<}"
    head = f"\\documentclass{{article}}\\usepackage{{amsmath,amssymb}}{names}\\begin{{document}}\n"
    (folder / "all.tex").write_text(f"{head}{body}\n\\end{{document}}\n", encoding="utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "all.tex"], cwd=folder, capture_output=True, text=True, check=False
    )
    return "\n".join(line for line in done.stdout.splitlines() if line.startswith(("! ", "l.")))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_formulas_compile(page, tmp_path):
    found = [formula for group in formulas(read(page)) for formula in group]
    assert len(found) > 5 and compiled(found, tmp_path) == ""


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
def test_a_formula_with_a_mistake_is_found(tmp_path):
    assert "Undefined control sequence" in compiled([r"x_1", r"\undefinedname x"], tmp_path)


def test_terms_of_the_glossary_are_in_alphabetical_order():
    lines = read(ROOT / "docs" / "glossary.md").splitlines()
    cells = [line.split("|")[1].strip() for line in lines if line.startswith("| ")]
    terms = [re.sub(r" ?\(.*\)", "", cell).lower() for cell in cells[2:]]
    assert len(terms) > 60 and terms == sorted(set(terms))


COMPONENTS = sorted((ROOT / "docs" / "components").rglob("*.md"))


@pytest.mark.parametrize("page", [*ALL, *COMPONENTS, *sorted(ROOT.glob("*.md"))], ids=lambda page: page.stem)
def test_links_lead_to_files_and_headings(page):
    missing = []
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]*))?\)", FENCE.sub("", read(page))):
        file = page.parent / target if target else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(read(file))):
            missing.append(f"{target}#{anchor}")
    assert missing == []
