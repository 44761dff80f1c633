"""docs/coming-from.md: its file runs with matrices of MATLAB, and what its tables name exists."""

import re

import numpy as np
from click.testing import CliRunner
from docs.followed_page import BLOCK
from docs.markdown import DOCS
from scipy.io import savemat

from rmpc_bench import load_results
from rmpc_bench.cli import main

TEXT = (DOCS / "coming-from.md").read_text("utf-8")
((_, NAME, FILE),) = [block for block in BLOCK.findall(TEXT) if block[1]]
SAVED = {"A": np.array([[1, 0.1], [0, 0.95]]), "B": np.array([[0], [0.1]]), "C": np.array([[1.0, 0.0]])}


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


def test_the_adapters_of_the_tables_exist():
    for library in ("do_mpc", "stonesoup", "filterpy"):
        source = (DOCS.parent / "rmpc_bench" / "adapters" / f"{library}.py").read_text("utf-8")
        named = re.findall(rf"`({library}_\w+)`", TEXT)
        assert named and all(f"def {name}(" in source for name in named)
