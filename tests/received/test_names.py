"""Names of a configuration and of a stored layout follow the same rules."""

import json
import re
import sys
from time import process_time

import pytest
from small_experiment import cli, write

from rmpc_bench.config.methods import LabelError, Parameter, fill
from rmpc_bench.config_file.yaml import parse
from rmpc_bench.figures.labels import shortened, typeset, wrapped
from rmpc_bench.received.names import (
    LONGEST_LABEL,
    wrong_experiment,
    wrong_formula,
    wrong_label,
    wrong_method,
    wrong_metric,
    wrong_text,
)
from rmpc_bench.received.plain_files import MANIFEST, checked, wrong_command
from rmpc_bench.report.page.rendering import FormulaError, formula_html
from rmpc_bench.types import ConfigError

HIDDEN = ["\x1b", "\x07", "\x7f", "\x9b", "\u061c", "\u202e", "\u2066", "\ud800"]


@pytest.mark.parametrize("character", HIDDEN)
def test_hidden_characters(character):
    """In no text, hence in no name."""
    for rule in (wrong_text, wrong_method, wrong_experiment, wrong_metric):
        assert rule(f"a{character}b") and rule(f"a{character}b").isprintable()


def test_names_that_are_good():
    """As papers write them, in any script."""
    for name in ("R-MPC", "KF", "\u03b8 = 0.1", "\u05d0\u05d1", "a/b", "=1+1|../../x", "<b>"):
        assert wrong_method(name) == ""
    assert (
        wrong_text("two\nlines\tand a tab") == "" and wrong_experiment("a.b-c_1") == "" and wrong_metric("mse_2") == ""
    )


@pytest.mark.parametrize("name", ["", "..", ".a", "-a", "a/b", "/a", "a b", "a\n", "\u0661", 7, None])
def test_names_of_directories(name):
    """Nothing that leads elsewhere."""
    assert wrong_experiment(name)


@pytest.mark.parametrize("escape", ["\\e", "\\x07", "\\u202E", "\\u2066", "\\x9b"])
@pytest.mark.parametrize(
    "keys",
    [
        {"methods": '{"a$b": {estimator: {kind: kalman}}}'},
        {"title": '"a$b"'},
        {"methods": '{S-MPC: {estimator: {kind: kalman}, label: "a$b"}}'},
    ],
)
def test_escapes_in_a_configuration(tmp_path, escape, keys):
    """YAML can write any character; the place and the character are named."""
    result = cli("check", write(tmp_path, **{key: text.replace("$", escape) for key, text in keys.items()}))
    assert result.exit_code == 2 and "tiny.yaml:" in result.stderr
    assert (
        re.search(r"contains the (control|direction) character U\+", result.stderr)
        and result.stderr.replace("\n", "").isprintable()
    )


@pytest.mark.parametrize(("name", "label"), [("a\\u200bb", "x"), ("a\\u2028b", "x"), ("a", "x" * (LONGEST_LABEL + 1))])
def test_what_a_manifest_would_refuse_is_refused_before_the_runs(tmp_path, name, label):
    """Invisible characters and lines in the name of a method, and a label that is too long."""
    methods = f'{{"{name}": {{estimator: {{kind: kalman}}, label: "{label}"}}}}'
    assert cli("check", write(tmp_path, methods=methods)).exit_code == 2
    assert wrong_method(json.loads(f'"{name}"')) or wrong_label(label)


def test_a_command_that_a_page_recommends():
    """It computes an experiment: no other program, no word of a shell, no code of somebody else."""
    assert not wrong_command("rmpc-bench run 'a b.yaml' -s 'x=[1, 2]' --runs 4 --only a")
    for text in (
        "curl x | sh",
        "rmpc-bench run",
        "rmpc-bench run a; sh",
        "rmpc-bench run --allow-code a b",
        "run 'a",
        7,
    ):
        assert wrong_command(text), text


DEEP = {
    **{part: part * 11 + "x" + "}" * 11 for part in (r"\overline{", r"\frac{1}{", r"\sqrt{", "x^{", "{", r"\hat {")},
    "parentheses": r"\left(" * 11 + "x" + r"\right)" * 11,
    "brackets": r"\sqrt[" * 11 + "3" + "]{x}" * 11,
    "accents": r"\hat" * 40 + " x",
    "long": "x^2+" * 130 + "x",
    "not closed": r"\sqrt {" * 300,
}


@pytest.mark.parametrize("kind", DEEP)
def test_formulas_that_are_nested_too_deep(kind):
    """They are refused where a configuration, a layout or a manifest is read: their readers call themselves."""
    text = f"a {{b}} $x$, ${DEEP[kind]}$"
    assert wrong_text(text) == wrong_formula(text) != ""
    with pytest.raises(ConfigError, match=r"f:1:8: label: has a formula (that is nested|of more|with more)"):
        parse(f"label: '{text}'", "f")
    for field, value in (("name", text), ("report", {"keys": {"title": text}})):
        with pytest.raises(ValueError, match=f"{field}.*: has a formula "):
            checked(json.dumps({field: value}).encode(), MANIFEST)


def test_formulas_that_papers_have():
    """Nothing without dollar signs is a formula."""
    for text in (
        r"$\frac{\sqrt[3]{x_{k+1}^{2}}}{\left(\hat{\theta}-\bar{\theta}\right)^{2}}$, $\alpha\beta\gamma\Delta$",
        "{" * 50 + r"\a" * 50,
        r"$\leftarrow\rightarrow$" * 30,
        "$x_{1}$ " * 100,
    ):
        assert wrong_formula(text) == ""


def test_labels_are_broken_in_linear_time():
    """A formula that a line separator cuts for one reader only has 2^26 readings where a backslash has two."""
    label, start = "$" + r"\;a" * 26 + "\u2028b$", process_time()
    assert "\n".join(wrapped(label, 1e9)) == label and shortened(label, 10.0)
    assert process_time() - start < 1


def test_readers_of_formulas_survive_any_depth():
    """As texts of a library may have them.  Libraries for notebooks raise the limit of recursion of a process."""
    depth = 2 * sys.getrecursionlimit()
    deep = r"\sqrt{" * depth + "x" + "}" * depth
    assert typeset(f"${deep}$") == rf"\${deep}\$"
    with pytest.raises(FormulaError, match="deep"):
        formula_html("{" * depth + "x" + "}" * depth)


def test_a_label_that_becomes_deep():
    """A template and the value in it are each as deep as allowed."""
    half, end = r"\hat{" * 6, "}" * 6
    values = [{"estimator.p": Parameter(f"{half}x{end}", False)}]
    assert fill("$${p}$", "m", values) == f"${half}x{end}$"
    with pytest.raises(LabelError, match="filled in, has a formula that is nested"):
        fill(f"${half}${{p}}{end}$", "m", values)
