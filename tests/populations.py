"""Populations for the coverage study: per-run values of methods, the baseline first.

`populations.csv` beside this file holds values of published experiments.  It is made again by

    make papers && python tests/populations.py

from trials.csv of these experiments.  The other populations are made here from them, or from a law with fixed seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

HERE = Path(__file__).parent
ROOT = HERE.parent
FILE = HERE / "populations.csv"

SOURCES = {
    "fig7": ("zenere2018/fig7", "mse", ["S-MPC", "R-MPC1", "R-MPC2", "R-MPC3"]),
    "settling": ("zenere2018/fig7", "settling_time", ["S-MPC", "R-MPC1", "R-MPC2", "R-MPC3"]),
    "settling_75": ("zenere2017/sim1", "settling_75", ["S-MPC", "R-MPC1", "R-MPC2"]),
    "error": ("zenere2018/fig7", "steady_state_error", ["S-MPC", "R-MPC1", "R-MPC2", "R-MPC3"]),
    "table2": ("ma2025/table2", "cost", ["RCMIX", "RCKF", "RCESM"]),
    "bursts": ("belda2017/bursts", "rms_all", ["constant", "tuned"]),
}
"""Name -> experiment, metric and methods."""


@dataclass(frozen=True, eq=False)
class Population:
    """All runs there are; an experiment draws some of them.

    Parameters
    ----------
    values : (n_runs, n_methods), the baseline first; NaN for a failed run, inf where the event did not occur
    direction : of the metric
    may_not_occur : whether the metric can be inf
    """

    values: np.ndarray
    direction: str = "lower"
    may_not_occur: bool = False


def stored() -> dict[str, np.ndarray]:
    """Return name -> (n_runs, n_methods) values of the published experiments."""
    table = pd.read_csv(FILE)
    return {
        name: part.pivot(index="run", columns="method", values="value")[SOURCES[str(name)][2]].to_numpy()
        for name, part in table.groupby("population")
    }


def populations() -> dict[str, Population]:
    """Return the populations of the study by name."""
    found = stored()
    fig7, settled = found["fig7"], found["settling"][:, 1:3]
    rng = np.random.Generator(np.random.PCG64(20261122))
    base = fig7[:, :1]
    equal = base * np.exp(0.1 * rng.standard_normal((len(base), 9)))
    skewed = rng.lognormal(size=5000)
    return {
        "Fig. 7, mse": Population(fig7),
        "Fig. 7, no change": Population(_with_change(fig7, 0.0)),
        "Fig. 7, change at the margin": Population(_with_change(fig7, -np.log(1.01))),
        "settling time, some inf": Population(found["settling"], may_not_occur=True),
        "settling time, 80 % tied": Population(_tied(settled, 0.8)),
        "settling time, 80 % tied, may be inf": Population(_tied(settled, 0.8), may_not_occur=True),
        "settling_75, 98 % tied": Population(found["settling_75"]),
        "settling_75, 98 % tied, may be inf": Population(found["settling_75"], may_not_occur=True),
        "steady-state error": Population(found["error"], direction="zero"),
        "table2, cost": Population(found["table2"]),
        "bursts": Population(found["bursts"]),
        "skewed logs": Population(np.exp(np.stack([0 * skewed, 0.1 * (skewed - skewed.mean())], axis=1))),
        "skewed values": Population(np.exp(rng.standard_normal((5000, 2)))),
        "eight equal methods": Population(_with_change(equal, 0.0)),
        "fails on the hardest 30 %": Population(_failing(base, 0.3, rng)),
        "fails on the hardest 3 %": Population(_failing(base, 0.03, rng)),
    }


def _with_change(values: np.ndarray, change: float) -> np.ndarray:
    """Scale the methods so that the mean log ratio to the baseline is `change`."""
    logs = np.log(values)
    gap = (logs - logs[:, :1]).mean(axis=0)
    return np.exp(logs - gap + change * (np.arange(values.shape[1]) > 0))


def _tied(values: np.ndarray, share: float) -> np.ndarray:
    """Make two methods equal in the first runs."""
    values = values.copy()
    n = int(share * len(values))
    values[:n, 1] = values[:n, 0]
    return values


def _failing(base: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Add a method that is equal on average and fails where the baseline is largest."""
    method = base * np.exp(0.05 * rng.standard_normal(base.shape))
    method[base > np.quantile(base, 1 - share)] = np.nan
    return np.concatenate([base, method], axis=1)


def _write() -> None:
    parts = []
    for name, (experiment, metric, methods) in SOURCES.items():
        frame = pd.read_csv(ROOT / "results" / experiment / "trials.csv")
        if "reference.values" in frame:
            frame = frame[frame["reference.values"] == frame["reference.values"].iloc[0]]
        frame = frame[frame["method"].isin(methods)][["method", "run", metric]]
        parts.append(frame.rename(columns={metric: "value"}).assign(population=name))
    table = pd.concat(parts)[["population", "method", "run", "value"]]
    table.to_csv(FILE, index=False, float_format="%.6g", lineterminator="\n")


if __name__ == "__main__":
    _write()
