"""The generated pages are what `make docs` writes now, and have every key, component and option."""

import itertools
import re
import shutil

import pytest
from docs.examples_of_keys import EXAMPLES
from docs.followed_page import FOLLOWED, README, followed
from docs.markdown import equation_of
from docs.pages import PAGES, left_over
from docs.test_methods import compiled
from jsonschema import Draft7Validator

from docs import reference_page
from rmpc_bench import registry
from rmpc_bench.components.designs import registered_design
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.schema.json_schema import json_schema
from rmpc_bench.schema.manual import manual_of

COMPONENTS = [(group, kind) for group in registry.BUILT_IN for kind in sorted(registry.BUILT_IN[group])]
METHODS = [each for each in COMPONENTS if each[0] in ("estimators", "controllers")]
PARAGRAPHS = {"Model", "Limit", "Cost", "Fails"}
IN_WORDS = {"plants": {"data", "fmu", "env"}, "inputs": {"file"}, "metrics": {"sample", "reported", "fallbacks"}}
EQUATIONS = {each: found for each in COMPONENTS if (found := equation_of(*each))}


MARKED = [
    pytest.param(page, marks=[pytest.mark.page(page.stem)] * (page in FOLLOWED[1:]), id=page.stem) for page in PAGES
]


@pytest.mark.parametrize("page", MARKED)
def test_a_page_is_up_to_date(page):
    written = page.read_text(encoding="utf-8")
    made = PAGES[page]()
    pairs = itertools.zip_longest(written.splitlines(), made.splitlines())
    changed = [f"now  {now}\nmade {new}" for now, new in pairs if now != new]
    assert written == made, f"docs/{page.name} is stale: make docs\n" + "\n".join(changed[:3])


def test_no_page_is_left_over():
    assert left_over() == [], "make docs"


@pytest.fixture(scope="module")
def schema():
    return json_schema()


def test_every_section_has_an_example_that_follows_the_schema(schema, tmp_path):
    """An editor would accept each of them."""
    assert {*schema["properties"]} == {*EXAMPLES}
    for name in schema["properties"]:
        example = EXAMPLES[name]
        file = tmp_path / f"{name}.yaml"
        file.write_text(example, encoding="utf-8")
        section = {**schema["properties"][name], "definitions": schema["definitions"]}
        errors = [error.message for error in Draft7Validator(section).iter_errors(plain(load(file))[name])]
        assert not errors, (name, errors)


def _with_inner(keys):
    return [each for key in keys for each in (key, *_with_inner(key.keys))]


@pytest.mark.parametrize(("group", "kind"), COMPONENTS)
def test_every_key_of_a_component_has_type_and_meaning(group, kind):
    for key in _with_inner(manual_of(group, kind, registered_design(group, kind)).keys):
        assert key.meaning, key.name
        assert key.kind and key.kind != "any value", key.name


def test_every_key_of_a_section_has_a_meaning(schema):
    for name, section in schema["properties"].items():
        for key in _with_inner(reference_page.keys_of_section(name, section)):
            assert key.meaning and key.kind, (name, key.name)


@pytest.mark.parametrize(("group", "kind"), [each for each in COMPONENTS if each[0] != "figures"])
def test_every_component_is_defined_by_an_equation_or_in_words(group, kind):
    """Figures are pictures; the module of every other component has an equation."""
    assert ((group, kind) in EQUATIONS) != (kind in IN_WORDS.get(group, ()))


@pytest.mark.parametrize(("group", "kind"), METHODS)
def test_the_module_of_a_method_says_what_it_must_say(group, kind):
    """`Limit` is the case in which the method is a known one; `init --component` leaves it to the author."""
    module = manual_of(group, kind, registered_design(group, kind)).module
    written = {label for label in PARAGRAPHS if re.search(rf"^{label} +\S", module, re.MULTILINE)}
    assert written == PARAGRAPHS, f"{kind}: write these paragraphs of the docstring of its module"


def test_equations_have_balanced_braces_and_no_escaped_punctuation():
    """A host reads a backslash before punctuation as Markdown."""
    for name, equation in EQUATIONS.items():
        assert equation.count("{") == equation.count("}"), name
        assert equation.count(r"\left") == equation.count(r"\right"), name
        assert not any(f"\\{mark}" in equation for mark in "{},;!#_"), name


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
def test_equations_compile(tmp_path):
    assert compiled([*EQUATIONS.values()], tmp_path) == ""


@pytest.mark.long
def test_every_file_of_a_run_is_on_the_page():
    """Oracle: the directory that the commands of the README write."""
    names = {name.strip("/") for entry in reference_page.FILES for name in entry.split(", ")}
    written = {path.name for path in (followed(README).place / "results" / "servo").iterdir()}
    assert {"trials.sqlite", "summary.csv", "figures"} <= written <= names
