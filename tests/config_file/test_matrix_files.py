"""Matrices from .mat, .npz and .csv files take the place of their names when a configuration is read."""

import shutil

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_matrix

from rmpc_bench import load_config, run
from rmpc_bench.types import ConfigError

A, B, C = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
Q, R = 0.01 * np.eye(2), np.array([[0.04]])
TEXT = """
version: 1
name: from-file
runs: 3
time: {{step: 0.1, steps: 5}}
plant: {plant}
model: {model}
noise: {{process: {{gaussian: {{cov: 0.01}}}}, measurement: {{gaussian: {{cov: 0.04}}}}}}
methods: {{A: {{estimator: {{kind: kalman}}}}}}
metrics: [estimation_mse]
"""
ROWS = "{kind: linear, A: [[0.9, 0.1], [0, 0.8]], B: [[0], [1]], C: [[1, 0]]}"
MODEL = ROWS[:-1] + ", P_w: [[0.01, 0], [0, 0.01]], P_v: [[0.04]]}"


def written(directory, plant=ROWS, model=MODEL, name="case.yaml"):
    path = directory / name
    path.write_text(TEXT.format(plant=plant, model=model), encoding="utf-8")
    return path


def problems(path, **options):
    with pytest.raises(ConfigError) as caught:
        load_config(path, **options)
    return [str(problem) for problem in caught.value.problems]


@pytest.fixture
def directory(tmp_path):
    savemat(tmp_path / "m.mat", {"A": A, "B": B, "C": C, "Q": Q, "R": R, "D": np.zeros((1, 1)), "Ts": 0.1})
    np.savez(tmp_path / "m.npz", A=A, B=B, C=C, Q=Q, R=R)
    np.savetxt(tmp_path / "A.csv", A, delimiter=",")
    return tmp_path


@pytest.mark.parametrize(
    ("plant", "model"),
    [
        ("{linear: {from: m.mat}}", "{linear: {from: m.mat}}"),
        ("{linear: {from: m.npz}}", "{linear: {from: m.npz}}"),
        (ROWS.replace("[[0.9, 0.1], [0, 0.8]]", "{file: A.csv}"), MODEL),
        (ROWS.replace("[[0.9, 0.1], [0, 0.8]]", "{file: m.npz, name: A}"), MODEL),
        (ROWS, MODEL.replace("[[0.04]]", "{file: m.mat, name: R}")),
    ],
)
def test_numbers_of_a_file_are_those_of_the_configuration(directory, plant, model):
    """Same numbers, same identity: the key of the trials is that of the configuration with written matrices."""
    expected = load_config(written(directory)).points[0].method_keys
    assert load_config(written(directory, plant, model)).points[0].method_keys == expected


def test_keys_beside_the_file_replace_those_of_the_file(directory):
    given = load_config(written(directory, model="{linear: {from: m.mat}, P_v: 4}")).methods["A"]["model"]
    assert (given["P_v"], given["A"]) == (4.0, A.tolist())


def test_the_resolved_configuration_needs_no_file(directory, tmp_path):
    results = tmp_path / "results"
    run(load_config(written(directory, "{linear: {from: m.mat}}")), directory=results, jobs=1)
    expected = load_config(written(directory)).hash
    (directory / "m.mat").unlink()
    assert load_config(results / "config.resolved.yaml").hash == expected


def test_a_name_is_relative_to_the_file_in_which_it_stands(directory, tmp_path):
    elsewhere = tmp_path / "below"
    elsewhere.mkdir()
    written(directory, "{linear: {from: m.mat}}", name="source.yaml")
    path = written(elsewhere, "{from: ../source.yaml}")
    assert load_config(path).hash == load_config(written(directory)).hash


def test_a_name_in_an_override_is_relative_to_the_configuration(directory, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path.parent)
    config = load_config(written(directory), overrides=["model.P_v={file: m.mat, name: R}"])
    assert config.methods["A"]["model"]["P_v"] == R.tolist()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("{file: n.mat, name: A}", "n.mat: there is no such file; did you mean 'm.mat'?"),
        ("{file: m.mat, name: a}", "m.mat has no matrix 'a'; there are A, B, C, Q, R, D, Ts"),
        ("{file: m.npz}", "m.npz has A, B, C, Q, R; add `name`"),
        ("{file: words.csv}", "words.csv has a, b; add `name`"),
        ("{file: letters.csv}", "letters.csv: must have rows of equally many numbers"),
        ("{file: text.mat, name: A}", "text.mat: "),
        ("{file: text.npz, name: A}", "text.npz: "),
        ("{file: complex.npz}", "must be a matrix of finite real numbers (got shape (1,) of type complex128)"),
        ("{file: nan.npz}", "must be a matrix of finite real numbers"),
        ("{file: object.npz}", "object.npz: A.npy has Python objects"),
        ("system.mat", "a file is written {file: system.mat, name: A}"),
        ("data/A.csv", "a file is written {file: data/A.csv}"),
        ("system.npy", "a file is written {file: system.npy, name: A}, and ends in .mat, .npz or .csv"),
        ("system.TXT", "a file is written {file: system.TXT, name: A}, and ends in .mat, .npz or .csv"),
        ("{file: other.mat, name: sys.A}", "sys is a struct; save its fields: save('other.mat', '-struct', 'sys')"),
        ("{file: other.mat, name: sys}", "sys is a struct; save its fields: save('other.mat', '-struct', 'sys')"),
        ("{file: other.mat, name: A}", "other.mat has no matrix 'A'; did you mean 'A1'?"),
        ("{file: other.mat, name: M2}", "other.mat has no matrix 'M2': sys is a struct; save its fields: "),
        ("{file: other.mat, name: P}", "P is a sparse matrix; save full(P)"),
        ("{file: other.mat, name: cells}", "cells is a cell array; save its numbers as a matrix"),
        ("{file: other.mat, name: words}", "words is text; save its numbers as a matrix"),
    ],
)
def test_a_file_without_the_matrix_is_an_error_at_its_name(directory, value, text):
    (directory / "words.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    (directory / "letters.csv").write_text("a,b\nc,2\n", encoding="utf-8")
    for name in ("text.mat", "text.npz"):
        (directory / name).write_text("no matrix", encoding="utf-8")
    others = {
        "sys": {"A": A},
        "sys1": A,
        "A1": A,
        "P": csc_matrix(A),
        "words": "two",
        "cells": np.array([A, "a"], dtype=object),
    }
    savemat(directory / "other.mat", others)
    np.savez(directory / "complex.npz", A=np.array([1j]))
    np.savez(directory / "nan.npz", A=np.array([[np.nan]]))
    np.savez(directory / "object.npz", A=np.array([{}], dtype=object))
    (found,) = problems(written(directory, ROWS.replace("[[0.9, 0.1], [0, 0.8]]", value)))
    assert "case.yaml:6:" in found
    assert ("plant.A.file: " if "file:" in value else "plant.A: ") in found
    assert text in found


def test_a_system_in_a_struct_names_the_way_out(directory):
    savemat(directory / "struct.mat", {"sys": {"A": A, "C": C}})
    savemat(directory / "step.mat", {"A": A, "C": C, "Ts": {"Ts": 0.1}})
    (found,) = problems(written(directory, "{linear: {from: struct.mat}}"))
    assert found.endswith("has no matrix 'A': sys is a struct; save its fields: save('struct.mat', '-struct', 'sys')")
    (found,) = problems(written(directory, "{linear: {from: step.mat}}"))
    assert "Ts is a struct" in found


def test_hdf5_files_of_matlab_name_the_way_out(directory):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    (directory / "new.mat").write_bytes(header + bytes(512))
    (found,) = problems(written(directory, "{linear: {from: new.mat}}"))
    assert "-v7" in found


def test_a_feedthrough_is_read_and_another_sampling_time_is_refused(directory):
    savemat(directory / "D.mat", {"A": A, "B": B, "C": C, "D": np.ones((1, 1))})
    savemat(directory / "Ts.mat", {"A": A, "B": B, "C": C, "Ts": 0.2})
    found = load_config(written(directory, "{linear: {from: D.mat}}")).experiment.plant
    assert found.feedthrough
    np.testing.assert_array_equal(found.system.at(0).D, [[1.0]])
    assert "Ts is 0.2, and time.step is 0.1" in problems(written(directory, "{linear: {from: Ts.mat}}"))[0]


def test_all_errors_are_shown_at_once(directory):
    found = problems(written(directory, "{linear: {from: n.mat}}", "{linear: {from: o.mat}}"))
    assert len(found) == 2


def test_a_matrix_may_be_swept(directory):
    shutil.copy(directory / "A.csv", directory / "A2.csv")
    path = written(directory)
    path.write_text(
        path.read_text(encoding="utf-8") + "sweep: {grid: {model.A: {one: {file: A.csv}, two: 0.5}}}\n",
        encoding="utf-8",
    )
    first, second = (point.methods["A"]["model"]["A"] for point in load_config(path).points)
    assert first == A.tolist()
    assert second == 0.5
