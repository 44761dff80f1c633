"""Start-up, store and report: whole commands beside the libraries that they need."""

import subprocess
import sys
import tempfile
from pathlib import Path

from perf.row import Row

FIG7 = "configs/zenere2018/fig7.yaml"
MAIN = "from rmpc_bench.cli import main; main()"
LIBRARIES = "import numpy, scipy.linalg, numba, pandas, matplotlib.figure"
PICTURE = """
import pandas, sys
from matplotlib.figure import Figure
rows = pandas.read_csv(sys.argv[1])
figure = Figure()
figure.subplots().boxplot([part["mse"] for _, part in rows.groupby("method")])
for ending in ("svg", "pdf", "png"):
    figure.savefig(sys.argv[1] + "." + ending)
rows.groupby("method").describe().to_csv(sys.argv[1] + ".summary")
"""


def python(code, *arguments):
    """Run Python in a process of its own; a unit is a call."""
    command = [sys.executable, "-c", code, *arguments]
    return lambda: subprocess.run(command, check=True, capture_output=True), 1


def stored():
    """Return a directory with all runs of Fig. 7 and its report."""
    place = Path(tempfile.mkdtemp()) / "fig7"
    python(MAIN, "run", FIG7, "-o", str(place), "--progress", "none")[0]()
    return place


def fresh():
    """Compute Fig. 7 anew, on one process."""
    place = Path(tempfile.mkdtemp()) / "fig7"
    return python(MAIN, "run", FIG7, "-o", str(place), "--fresh", "-j", "1", "--progress", "none")


def store_reads():
    """Read 16,000 stored trials into a table; a unit is a trial."""
    import numpy as np

    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution.results import run

    config = load_config(FIG7, runs=4000)
    with_store = run(config, directory=tempfile.mkdtemp(), jobs=1)
    assert len(with_store.trials.frame) == 16_000

    from rmpc_bench.execution.results import load_results

    place = with_store.directory
    return lambda: np.asarray(load_results(place).trials.frame["mse"]), 16_000


def plain_reads():
    """Read 16,000 rows of a plain SQLite table; a unit is a trial."""
    import sqlite3

    import pandas as pd

    file = Path(tempfile.mkdtemp()) / "plain.sqlite"
    with sqlite3.connect(file) as store:
        store.execute("create table trials (method text, run integer, status text, a real, b real, c real, d real)")
        rows = [(f"m{i % 4}", i // 4, "ok", 0.1 * i, 0.2 * i, 0.3 * i, 0.4 * i) for i in range(16_000)]
        store.executemany("insert into trials values (?, ?, ?, ?, ?, ?, ?)", rows)

    def work():
        with sqlite3.connect(file) as store:
            return pd.read_sql("select * from trials", store)

    return work, 16_000


def picture():
    return python(PICTURE, str(stored() / "trials.csv"))


def libraries():
    return python(LIBRARIES)


IMPORTS = "import of the libraries of a figure"
ROWS = [
    Row("--help", "call", lambda: python(MAIN, "--help"), libraries, IMPORTS),
    Row("check Fig. 7", "call", lambda: python(MAIN, "check", FIG7), libraries, IMPORTS),
    Row(
        "run with nothing to do",
        "call",
        lambda: python(MAIN, "run", FIG7, "-o", str(stored()), "--progress", "none"),
        libraries,
        IMPORTS,
    ),
    Row("Fig. 7, command to figure", "call", fresh, libraries, IMPORTS),
    Row("report of Fig. 7", "call", lambda: python(MAIN, "report", str(stored())), picture, "pandas, one boxplot"),
    Row("reading the store", "trial", store_reads, plain_reads, "SQLite, a row per trial"),
]
