"""A page of a small table of trials, with hostile texts wherever a user writes them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from comparison_tables import extent_of

from rmpc_bench.claims.claim import Claim, Finding
from rmpc_bench.claims.verdict import judge
from rmpc_bench.report.calibration_table import CalibrationTable
from rmpc_bench.report.page.context import page_context
from rmpc_bench.report.page.rendering import render_html, render_markdown
from rmpc_bench.report.ranks_table import RanksTable
from rmpc_bench.report.run_tables import DriversTable, RequirementsTable
from rmpc_bench.report.source import PageFigure, PageSource
from rmpc_bench.report.summary import summarise
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import MetricInfo

HOSTILE = "<script>alert('x')</script> \"|` [a](http://evil) $\\href{http://evil}$"
SVG = '<svg class="boxplot" aria-hidden="true" viewBox="0 0 9 9"><g data-method="B"><path d="M 0 0"/></g></svg>'
INFOS = (MetricInfo("mse", "rad^2", "lower"), MetricInfo("power", "V^2", "lower"))


@pytest.fixture(scope="session")
def make_source(make_trials):
    """Return a function that makes the source of a page from labels and other fields of `PageSource`."""

    def make(labels=None, n=40, **fields):
        rng = np.random.default_rng(3)
        mse = rng.lognormal(size=n)
        power = rng.lognormal(size=n)
        columns = {
            "mse": {"A": mse.tolist(), "B": (0.8 * mse).tolist()},
            "power": {"A": power.tolist(), "B": (power + 0.01).tolist()},
        }
        trials = make_trials(columns, infos=INFOS, labels=labels)
        trials = replace(trials, parameters=dict.fromkeys(trials.methods, "as published"))
        claims = (
            Claim(
                says=f"B is better {HOSTILE}",
                source="Section 1",
                check=("mean(mse[B]) < mean(mse[A])",),
                finding=Finding.CONFIRMED,
                quote=HOSTILE,
                assumptions=(HOSTILE, "One."),
                figures=("boxplot",),
            ),
            Claim(says="Not said there", source="additional result (ours)", check=("mean(mse[A]) < 0",)),
        )
        figures = [
            PageFigure("boxplot", "boxplot", f"Boxes of $c_1$ {HOSTILE}", SVG, [Path("figures/boxplot.svg")]),
            PageFigure(
                "signals", "signals", "Over time.", SVG.replace("boxplot", "signals"), [Path("figures/signals.svg")]
            ),
        ]
        usual = {
            "record": {
                "name": "tiny",
                "title": f"A small one {HOSTILE}",
                "paper": "zenere2018",
                "identifier": "arXiv:1804.06746",
                "runs": n,
                "seed": 7,
                "hash": "0123456789abcdef",
                "version": "0.1.0",
                "numerics": 3,
                "command": "rmpc-bench run configs/zenere2018/tiny.yaml",
                "final": True,
            },
            "trials": trials,
            "tables": summarise(trials),
            "verdicts": [judge(claim, trials) for claim in claims],
            "drivers": DriversTable([]),
            "requirements": RequirementsTable(trials, []),
            "ranks": RanksTable(trials, None),
            "tuning": TuningTable(trials, None),
            "calibration": CalibrationTable([]),
            "figures": figures,
            "place": "results/zenere2018/tiny",
            "differences": {"A": {"estimator.kind": "kalman"}, "B": {"estimator.kind": HOSTILE}},
            "shared": {"Plant": HOSTILE},
            "manifest": {
                "platform": {"system": "Linux", "cores": 2},
                "git": {"commit": "a" * 40, "dirty": True},
                "versions": {"python": "3.11.7"},
                "sessions": [{"start": "2026-01-02T03:04:05+00:00", "stop": "2026-01-02T03:04:08+00:00"}],
            },
            "files": ["trials.csv", "tables/summary.md", "report.md"],
        }
        found = {**usual, **fields}
        found.setdefault("extent", extent_of(found["trials"]))
        return PageSource(**found)

    return make


@pytest.fixture(scope="session")
def html(make_source):
    """Return the page with hostile labels."""
    return render_html("page.html", page_context(make_source(labels={"B": HOSTILE})))


@pytest.fixture(scope="session")
def markdown(make_source):
    """Return the same as Markdown."""
    return render_markdown("page.md", page_context(make_source(labels={"B": HOSTILE})))
