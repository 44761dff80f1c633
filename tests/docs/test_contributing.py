"""CONTRIBUTING.md: its scaffold is followed in a copy of the clone, and its files exist."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from docs.markdown import ROOT

TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
ADDED = {"estimators": "new-filter", "controllers": "new-law", "metrics": "new_metric"}
LIMIT = "tests/docs/test_generated_pages.py::test_the_module_of_a_method_says_what_it_must_say"
FILES = (
    *("conformance", "test_registry.py", "docs/test_generated_pages.py", "docs/test_examples_of_kinds.py"),
    *("controllers/test_constant_parts.py", "controllers/test_operating_points.py"),
    *(
        "config/test_noise_laws.py",
        "config/test_robot_configs.py",
        "models/test_nonlinear.py",
        "estimators/test_late_measurements.py",
    ),
)
"""Tests that know the kinds, below tests/."""


def run(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PYTHONPATH": f"{place}:{place / 'tests'}", "RMPC_BENCH_TESTS": ""}
    return subprocess.run([sys.executable, *arguments], cwd=place, env=env, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Return a copy of the clone with a new component of every group that has a template."""
    place = tmp_path_factory.mktemp("clone")
    for each in ROOT.iterdir():
        if each.name in ("rmpc_bench", "tests"):
            shutil.copytree(each, place / each.name, ignore=shutil.ignore_patterns("__pycache__"))
        elif not each.name.startswith("."):
            (place / each.name).symlink_to(each)
    for group, kind in ADDED.items():
        assert f"{group}/{kind.replace('new', 'my')}" in TEXT
        done = run(place, "-m", "rmpc_bench", "init", "--component", f"{group}/{kind}")
        assert done.returncode == 0, done.stderr
    return place


@pytest.mark.page("contributing")
def test_a_scaffold_passes_all_tests_once_its_limit_is_written(copy):
    """Oracle: all tests whose name has that of the kind, and those that compare lists of kinds with the registry."""
    names = {name for kind in ADDED.values() for name in (kind, kind.replace("-", "_"))}
    assert 'pytest -k "my-filter or my_filter or every_kind"' in TEXT
    chosen = " or ".join([*sorted(names), "every_kind"])
    chosen = f"({chosen}) and not up_to_date"  # `make docs` writes the pages
    own = [f"tests/{group}/test_{kind.replace('-', '_')}.py" for group, kind in ADDED.items()]
    files = [*(f"tests/{file}" for file in FILES), *own, "rmpc_bench/metrics/new_metric.py"]
    done = run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", chosen, *files)
    failed = re.findall(r"^FAILED (\S+)", done.stdout, re.MULTILINE)
    limits = [f"{LIMIT}[{group}-{ADDED[group]}]" for group in ("estimators", "controllers")]
    assert failed == limits, done.stdout[-3000:]
    assert int(re.search(r"(\d+) passed", done.stdout)[1]) > 50
    for group in ("estimators", "controllers"):
        module = copy / "rmpc_bench" / group / f"{ADDED[group].replace('-', '_')}.py"
        text = module.read_text(encoding="utf-8")
        assert text.count("\nLimit\n") == 1
        text = text.replace("\nLimit\n", "\nLimit   factor = 1 gives the Kalman filter.\n")
        module.write_text(text, encoding="utf-8")
    done = run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "new-filter or new-law", LIMIT)
    assert done.returncode == 0, done.stdout[-3000:]


def test_every_file_that_is_named_exists():
    """Files to be written are those of the scaffold."""
    named = re.findall(r"`([\w./]+\.(?:py|csv|cff|toml))`|\]\(([\w./-]+)", TEXT)
    found = {each for pair in named for each in pair if each and "FILE" not in each and "my_filter" not in each}
    roots = (ROOT, ROOT / "rmpc_bench", ROOT / "rmpc_bench" / "estimators")
    assert len(found) > 20
    assert [each for each in sorted(found) if not any((root / each).exists() for root in roots)] == []
