"""docs/own-simulator.md: a Python program that writes the same tables as the programs in MATLAB and Julia."""

import re
from pathlib import Path

import numpy as np
import pytest

import rmpc_bench

PAGE = (Path(__file__).parents[2] / "docs" / "own-simulator.md").read_text(encoding="utf-8")
COLUMNS = ["run", "method", "status", "eps", "mse"]


def simulate(method, eps, w):
    """Return the mean squared error of the loop of the page."""
    x, total, errors = 0.0, 0.0, []
    for each in w:
        errors.append(1 - x)
        total += errors[-1]
        x = (0.8 + eps) * x + 0.5 * errors[-1] + (0.1 * total if method == "PI" else 0.0) + each
    return float(np.mean(np.square(errors)))


def rows():
    """Yield the rows of the table."""
    rng = np.random.default_rng(1)
    for run in range(1, 201):
        eps, w = 0.4 * rng.random() - 0.2, 0.05 * rng.normal(size=50)
        for method in ("P", "PI"):
            yield run, method, True, eps, simulate(method, eps, w)


WRITERS = {
    # writetable: 15 digits, 1 and 0 for logical values.
    "matlab": lambda value: (
        str(int(value)) if isinstance(value, bool) else f"{value:.15g}" if isinstance(value, float) else str(value)
    ),
    # CSV.write: shortest digits, true and false.
    "julia": lambda value: str(value).lower() if isinstance(value, bool) else str(value),
}


@pytest.mark.parametrize("language", WRITERS)
def test_the_table_of_another_language_is_imported(tmp_path, language):
    lines = [COLUMNS, *([WRITERS[language](cell) for cell in row] for row in rows())]
    file = tmp_path / "runs.csv"
    file.write_bytes("".join(",".join(line) + "\n" for line in lines).encode())
    results = rmpc_bench.import_runs(file, directory=tmp_path / "o", settings={"uncertainty": {"eps": "+-20%"}})
    (row,) = rmpc_bench.compare(results, "mse").to_frame().to_dict("records")
    assert (row["method"], row["baseline"], row["verdict"], row["n_pairs"]) == ("PI", "P", "better", 200)
    assert results.trials.run_names == tuple(range(1, 201))


def test_the_programs_write_these_columns():
    matlab, julia = (re.search(rf"```{name}\n(.*?)```", PAGE, re.DOTALL)[1] for name in ("matlab", "julia"))
    assert f"table({', '.join(COLUMNS)})" in matlab
    assert re.findall(r"(\w+)=\w+\[\]", julia) == COLUMNS
    assert PAGE.split("```text\n")[1].split("\n")[0] == ",".join(COLUMNS)
