"""Start-up, store and report: whole commands beside the libraries that they need."""

import subprocess
import sys
import tempfile
from pathlib import Path

from perf.row import Row

FIG7 = "configs/zenere2018/fig7.yaml"
MAIN = "from rmpc_bench.cli import main; main()"
RUNS, BLOCK = 4000, 50
METHODS, NAMES = ("a", "b", "c", "d"), ("mse", "power", "settling", "error")
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

    def work():
        subprocess.run(command, check=True, capture_output=True)

    return work, 1


def stored():
    """Return a directory with all runs of Fig. 7 and its report."""
    place = Path(tempfile.mkdtemp()) / "fig7"
    python(MAIN, "run", FIG7, "-o", str(place), "--progress", "none")[0]()
    return place


def fresh(config=FIG7):
    """Compute an experiment anew, on one process."""
    place = Path(tempfile.mkdtemp()) / "fresh"
    return python(MAIN, "run", config, "-o", str(place), "--fresh", "-j", "1", "--progress", "none")


def trials(n_runs=RUNS):
    """Return the numbers of a stored experiment: metrics (4, runs) and a named uncertain value (runs)."""
    import numpy as np

    rng = np.random.default_rng(0)
    return rng.standard_normal((len(METHODS), 4, n_runs)), rng.standard_normal(n_runs)


def store_writes():
    """Store trials of four metrics and a named value in blocks of 50 runs; a unit is a trial."""
    import numpy as np

    from rmpc_bench.simulation.closed_loop import Block
    from rmpc_bench.store.store import Store
    from rmpc_bench.types import Journal

    metrics, eps = trials()

    def work():
        place = Path(tempfile.mkdtemp())
        with Store(place) as store:
            for number, method in enumerate(METHODS):
                for first in range(0, RUNS, BLOCK):
                    runs = range(first, first + BLOCK)
                    part = metrics[number, :, first : first + BLOCK]
                    block = Block(np.zeros(BLOCK, dtype=np.int8), part, {}, (), Journal())
                    columns = dict(zip(NAMES, part, strict=True))
                    store.add_block(method, runs, block, columns, "draw", {"eps": eps[first : first + BLOCK]})
        with Store(place, writable=False) as store:
            return store.values(METHODS[0], NAMES[0], np.arange(RUNS))

    return work, RUNS * len(METHODS)


def plain_writes():
    """Write the same into plain SQLite, a row per trial and a commit per block; a unit is a trial."""
    import sqlite3

    metrics, eps = trials()

    def work():
        store = sqlite3.connect(Path(tempfile.mkdtemp()) / "plain.sqlite")
        store.execute("create table trials (method text, run integer, status text, a real, b real, c real, d real)")
        store.execute("create table drawn (run integer, eps real)")
        for number, method in enumerate(METHODS):
            for first in range(0, RUNS, BLOCK):
                runs = range(first, first + BLOCK)
                rows = [(method, run, "ok", *metrics[number, :, run].tolist()) for run in runs]
                store.executemany("insert into trials values (?, ?, ?, ?, ?, ?, ?)", rows)
                if number == 0:
                    store.executemany("insert into drawn values (?, ?)", [(run, float(eps[run])) for run in runs])
                store.commit()
        found = store.execute("select a from trials where method = ? order by run", METHODS[:1]).fetchall()
        store.close()
        return [value for (value,) in found]

    return work, RUNS * len(METHODS)


def store_reads():
    """Read stored trials into a table; a unit is a trial."""
    import numpy as np

    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution.run import run
    from rmpc_bench.results.results import load_results

    place = run(load_config(FIG7, runs=RUNS), directory=tempfile.mkdtemp(), jobs=1).directory
    return lambda: np.sort(load_results(place).trials.frame["mse"])[:20], RUNS * len(METHODS)


def plain_reads():
    """Read as many rows of a plain SQLite table; a unit is a trial."""
    import sqlite3

    import numpy as np
    import pandas as pd

    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution.run import run

    frame = run(load_config(FIG7, runs=RUNS), directory=tempfile.mkdtemp(), jobs=1).trials.frame
    store = sqlite3.connect(Path(tempfile.mkdtemp()) / "plain.sqlite")
    frame.to_sql("trials", store, index=False)

    return lambda: np.sort(pd.read_sql("select * from trials", store)["mse"])[:20], len(frame)


def picture():
    return python(PICTURE, str(stored() / "trials.csv"))


def libraries():
    return python(LIBRARIES)


IMPORTS = "import of the libraries of a figure"
ROW_PER_TRIAL = "SQLite, a row per trial, a commit per block"
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
    Row("quickstart, command to figure", "call", lambda: fresh("quickstart"), libraries, IMPORTS),
    Row("report of Fig. 7", "call", lambda: python(MAIN, "report", str(stored())), picture, "pandas, one boxplot"),
    Row("writing the store, blocks of 50 runs", "trial", store_writes, plain_writes, ROW_PER_TRIAL),
    Row("reading the store", "trial", store_reads, plain_reads, "SQLite, a row per trial"),
]
