"""Results under version control: which files are kept, and that nothing else is."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from rmpc_bench import load_config
from rmpc_bench.claims.claim import Claim, Finding
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.config_file import yaml
from rmpc_bench.config_file.tree import plain
from rmpc_bench.types.texts import inert_markdown

ROOT = Path(__file__).parents[1]
CONFIGS = sorted((ROOT / "configs").glob("*/*.yaml"))
KEPT = {"summary.csv", "comparisons.csv", "tuning.csv", "tuning.json", "ranks.csv", "lost.csv"}
KEPT |= {"claims.md", "claims.json"}
OTHER = ("trials.csv", "series.csv", "trials.sqlite", "manifest.json", "figures/boxplot.pdf", "figures/boxplot-2.svg")


def first_figure(path):
    """Name of the file of a configuration's first figure; None without figures."""
    figures = yaml.load(path).get("figures") or [None]
    return figures[0] if figures[0] is None or isinstance(figures[0], str) else figures[0]["kind"]


def directory(path):
    """Return where the results of a configuration are, from the top of the repository."""
    return f"results/{path.parent.name}/{path.stem}"


def test_the_first_figure_of_every_published_experiment_is_kept():
    """One line of .gitignore per figure, and no other figure."""
    lines = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    published = {directory(path): first_figure(path) for path in CONFIGS if path.parent.name != "benchmarks"}
    expected = [f"!{place}/figures/{figure}.svg" for place, figure in published.items() if figure]
    assert [line for line in lines if line.endswith(".svg")] == expected


def test_git_keeps_these_files_and_no_others(tmp_path):
    """As git itself reads .gitignore and .gitattributes."""
    for file in (".gitignore", ".gitattributes"):
        shutil.copy(ROOT / file, tmp_path)
    subprocess.run(["git", "init", "--quiet", "."], cwd=tmp_path, check=True)
    place = "results/zenere2018/fig7"
    figures = [f"figures/{kind}.svg" for kind in ("boxplot", "rows", "trajectories")]
    names = [f"{place}/{name}" for name in (*sorted(KEPT), *OTHER, *figures)]
    command = ["git", "check-ignore", "--no-index", *names]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert set(names) - set(done.stdout.split()) == {f"{place}/{name}" for name in {*KEPT, "figures/boxplot.svg"}}
    command = ["git", "check-attr", "diff", f"{place}/figures/boxplot.svg", f"{place}/summary.csv"]
    attributes = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [line.rsplit(" ", 1)[1] for line in attributes] == ["unset", "unspecified"]


RECORDS = sorted((ROOT / "results").glob("*/*/claims.json"))
OF_SYSTEMS = [each for each in RECORDS if each.parents[1].name == "benchmarks"]


def hashes(record):
    """Return the hash of a kept record and that of its configuration."""
    config = ROOT / "configs" / record.parents[1].name / f"{record.parent.name}.yaml"
    return json.loads(record.read_text(encoding="utf-8"))["experiment"]["hash"], load_config(config).hash


@pytest.mark.parametrize("record", OF_SYSTEMS, ids=lambda each: each.parent.name)
def test_kept_results_are_those_of_their_configuration(record):
    """A key that is added to a component must not change the hash of experiments that do not use it."""
    kept, now = hashes(record)
    assert kept == now


@pytest.mark.slow
def test_all_kept_results_are_those_of_their_configurations():
    """All experiments of which claims are kept."""
    wrong = [str(record.parent) for record in RECORDS if len(set(hashes(record))) > 1]
    assert RECORDS and not wrong


def texts_of(node):
    """Every text below `claims` of a configuration."""
    if isinstance(node, dict):
        return [text for value in node.values() for text in texts_of(value)]
    return [text for value in node for text in texts_of(value)] if isinstance(node, list) else [str(node)]


def test_code_in_the_texts_of_claims_stays_code():
    """Backticks of the project's own texts are written as they are; others that do not close are escaped."""
    with_code = [path for path in CONFIGS if "`" in path.read_text(encoding="utf-8")]
    found = [text for path in with_code for text in texts_of(plain(yaml.load(path)).get("claims") or [])]
    found = [text for text in found if "`" in text]
    for text in found:
        claim = Claim(says="s", source="p. 1", check=(), finding=Finding.NOT_TESTABLE, assumptions=(text,))
        verdict = ClaimVerdict(claim, Finding.NOT_TESTABLE, (), 0, 1)
        assert inert_markdown(" ".join(text.split())) in claims_markdown([verdict], informational=False)
    assert len(found) > 5 and any("`rmpc-bench check configs/zenere2018/sim2.yaml --deep`" in text for text in found)
    kept = [path.with_suffix(".md").read_text(encoding="utf-8") for path in RECORDS]
    assert not any("&#96;" in text for text in kept)
    hostile = claims_markdown([replace(verdict, claim=replace(claim, says="a ` b <i>"))], informational=False)
    assert "a &#96; b &lt;i" in hostile
