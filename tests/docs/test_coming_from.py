"""docs/coming-from.md: its file runs with matrices of MATLAB, and what its tables name exists."""

import re

import numpy as np
import pytest
from click.testing import CliRunner
from docs.followed_page import BLOCK, COMING_FROM
from docs.markdown import DOCS
from scipy.io import savemat
from scipy.linalg import expm

from rmpc_bench import load_results
from rmpc_bench.cli import main

TEXT = COMING_FROM.read_text("utf-8")
((NAME, FILE),) = [block[1:] for block in BLOCK.findall(TEXT) if block[0] == "yaml"]
SAVED = {"A": np.array([[1, 0.1], [-0.2, 0.95]]), "B": np.array([[0], [0.1]]), "C": np.array([[1.0, 0.0]])}
K, SHARE = 2.0, 0.3
"""Spring constant of the page and its uncertainty."""


def sampled(k):
    """A of the page; oracle of its script: the exponential of the continuous A over 0.1 s."""
    return expm(0.1 * np.array([[0, 1], [-k, -0.2]]))


def test_the_file_runs_with_matrices_of_matlab(tmp_path):
    """`save(.., '-v7')` of MATLAB and `savemat` write the same format; oracle: the same matrices in the file."""
    savemat(tmp_path / "system.mat", SAVED, do_compression=True)
    (tmp_path / NAME).write_text(FILE, "utf-8")
    given = FILE
    for name, matrix in SAVED.items():
        given = given.replace(f"{{file: system.mat, name: {name}}}", str(matrix.tolist()))
    assert "system.mat" not in given
    (tmp_path / "given.yaml").write_text(given.replace("from_matlab", "given"), "utf-8")
    values = []
    for name in (NAME, "given.yaml"):
        assert CliRunner().invoke(main, ["check", str(tmp_path / name)]).exit_code == 0
        made = tmp_path / name.removesuffix(".yaml")
        done = CliRunner().invoke(main, ["run", str(tmp_path / name), "--smoke", "--no-report", "-q", "-o", str(made)])
        assert done.exit_code == 0, done.output
        trials = load_results(made).trials
        values.append([trials.column("mse", method) for method in ("Kalman", "robust")])
    np.testing.assert_array_equal(*values)


def test_what_the_page_says_of_the_entries_of_a():
    """The share of A(2,1), the errors of both forms of `H_A`, and the change of B."""
    given = float(re.search(r"30%\*([\d.]+)\]", FILE)[1])
    assert sampled(K)[1, 0] == pytest.approx(-given, abs=5e-5) and f"A(2,1) = -{given} " in FILE
    half = (sampled((1 + SHARE) * K) - sampled((1 - SHARE) * K)) / 2
    U, S, V = np.linalg.svd(half)
    errors = {"simple": 0.0, "svd": 0.0}
    for F in np.linspace(-1, 1, 21):
        change = sampled((1 + SHARE * F) * K) - sampled(K)
        simple = F * SHARE * np.array([[0, 0], [sampled(K)[1, 0], 0]])
        for name, form in (("simple", simple), ("svd", F * S[0] * np.outer(U[:, 0], V[0]))):
            errors[name] = max(errors[name], abs(change - form).max())
    assert f"{errors['simple']:.0e}" == "3e-03" and f"{errors['svd']:.0e}" == "6e-05"
    assert "errors of 0.003 in A" in TEXT and "A is right to 6e-5" in TEXT


def test_the_adapters_of_the_tables_exist():
    for library in ("do_mpc", "stonesoup", "filterpy"):
        source = (DOCS.parent / "rmpc_bench" / "adapters" / f"{library}.py").read_text("utf-8")
        named = re.findall(rf"`({library}_\w+)`", TEXT)
        assert named and all(f"def {name}(" in source for name in named)
