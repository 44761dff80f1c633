"""CSV files have the bytes of pandas."""

import numpy as np
import pandas as pd
import pytest

from rmpc_bench.report import csv_file
from rmpc_bench.report.csv_file import write_csv

RNG = np.random.default_rng(2)
FRAMES = {
    "floats": pd.DataFrame({"a": [0.1, 1e300, 1e-5, -0.0], "b": [np.nan, np.inf, -np.inf, 1e16]}),
    "random": pd.DataFrame(RNG.lognormal(0, 50, (300, 3)), columns=list("abc")),
    "kinds": pd.DataFrame(
        {"run": [1, 2, 3], "small": np.array([1.5, np.nan, 0.1], dtype=np.float32), "ok": [True, False, True]}
    ),
    "texts": pd.DataFrame({"name": ["a,b", 'c"d', "e\nf", "é, ä", "", None, " x "], "n": range(7)}),
    "mixed": pd.DataFrame({"a": [1, 2.5, "x", None, np.nan, "1,5", True], "b": [1] * 7}, dtype=object),
    "nullable": pd.DataFrame({"n": pd.array([1, None, 3], dtype="Int64"), "b": [1.0, 2.0, np.nan]}),
    "empty": pd.DataFrame({"a": [], "b": []}),
    "one column": pd.DataFrame({"a": [1.0, np.nan]}),
    "names": pd.DataFrame([[1, 2]], columns=["controller.Hp, Hu", 'a"b']),
    "nothing": pd.DataFrame(),
}


@pytest.mark.parametrize("name", FRAMES)
def test_bytes_of_pandas(name, tmp_path, monkeypatch):
    """Oracle: `DataFrame.to_csv`, also where blocks of rows end."""
    frame = FRAMES[name]
    for rows in (2, 20_000):
        monkeypatch.setattr(csv_file, "ROWS", rows)
        write_csv(frame, tmp_path / "a.csv")
        expected = frame.to_csv(index=False, lineterminator="\n").encode()
        assert (tmp_path / "a.csv").read_bytes() == expected


def test_a_carriage_return_is_in_quotes(tmp_path):
    """Readers take it for the end of a line; the csv module of Python 3.11 writes it as it is."""
    frame = pd.DataFrame({"name": ["g\rh", "i"], "n": [1, 2]})
    write_csv(frame, tmp_path / "a.csv")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "a.csv"), frame, check_dtype=False)
