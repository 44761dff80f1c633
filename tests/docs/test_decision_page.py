"""docs/choose-an-estimator.md: every number of its sentences is in the kept results; no rank of the suite is used."""

import re

import pandas as pd
import pytest
from docs.decision_page import PAGE, kept
from docs.markdown import ROOT

TEXT = PAGE.read_text(encoding="utf-8")
WORDS = re.sub(r"\s+", " ", re.sub(r"<!-- begin.*?end of the table -->", "", TEXT, flags=re.DOTALL))
BALLS = ("R-MPC", "WKF", "H-inf")


def less(name, *methods, points=None):
    """Return by how many per cent the errors of methods are smaller, in all points or some of them, sorted."""
    found = kept(name)
    chosen = found["method"].isin(methods) & (found["name"].isin(points) if points else True)
    assert {*found["method"][chosen]} == {*methods}
    return sorted((-found["change_pct"][chosen]).tolist())


def ends(values, decimals=1):
    return tuple(f"{each:.{decimals}f}" for each in (values[0], values[-1]))


def test_outliers():
    low, high = ends(less("estimators/outliers", "student", "huber", points=["5 % outliers", "10 % outliers"]), 0)
    assert f"{low} to {high} % less error with 5 and 10 % outliers; without outliers equivalent" in WORDS
    rows = kept("estimators/outliers").set_index(["name", "method"])
    assert {rows.loc[("clean", each), "verdict"] for each in ("student", "huber")} == {"equivalent"}
    heavy = ["t with 3 degrees of freedom", "10 % outliers and 5 % in the process"]
    low, high = ends(less("estimators/outliers", "student", "huber", points=heavy), 0)
    assert f"{low} to {high} % less error;" in WORDS
    single = rows.loc[[(point, each) for point in heavy for each in ("gate", "correntropy")]]
    few = single["far_worse_runs"].astype(int)
    assert (single["ci_high"] > 1e6).all() and f"lost {few.min()} to {few.max()} of 200 runs" in WORDS
    assert f"{few.min()} to {few.max()} of the runs determine the mean" in WORDS


def test_dry_friction():
    name = "estimators/friction-tuned"
    (tuned,), balls = less(name, "KF-R", points=["no noise"]), less(name, *BALLS, points=["no noise"])
    low, high = ends(balls)
    (fading,), pole = less(name, "fading", points=["no noise"]), ends(less("estimators/drift", "fading"))
    beside = f"{low} to {high} %, fading memory {fading:.1f} %"
    assert f"{tuned:.1f} % less error than untuned; robust filters, tuned alike, {beside}" in WORDS
    assert f"fading memory {pole[0]} to {pole[1]} % less than the tuned Kalman filter" in WORDS
    low, high = ends(less(name, "KF-R", "KF-dist"))
    nonlinear = ends(less(name, "EKF", "UKF"))
    assert f"{low} to {high} % less error; extended and unscented filters" in WORDS
    assert f"gain {nonlinear[0]} to {nonlinear[1]} %" in WORDS
    (extended,), (unscented,) = (less(name, each, points=["no noise"]) for each in ("EKF", "UKF"))
    assert f"differ by {extended - unscented:.1f} % under dry friction" in WORDS
    (default,) = less("estimators/friction", "UKF", points=["no noise"])
    assert f"with its default noise gains {default:.1f} % only" in WORDS


def test_the_price_of_a_rougher_input():
    table = pd.read_csv(ROOT / "results" / "estimators" / "friction-tuned" / "comparisons.csv")
    rows = table[(table["metric"] == "input_roughness") & (table["name"] == "0.1 rad")].set_index("method").change_pct
    stated = (
        f"by {rows['fading']:.1f} % with a fading memory, {rows['KF-dist']:.1f} % with an input disturbance, "
        f"{rows['KF-R']:.1f} % with tuned measurement noise"
    )
    assert stated in WORDS


def test_an_uncertain_pole():
    low, high = ends(less("estimators/drift", "KF-dir"))
    assert f"{low} to {high} % less error on three systems" in WORDS
    directional, informed = less("estimators/drift", "KF-dir"), less("estimators/drift", "LMMSE")
    assert all(abs(a - b) < 0.3 for a, b in zip(directional, informed, strict=True))
    assert less("estimators/drift", "WKF", "R-KF", "H-inf", "fading")[0] > 0


def test_bounded_noise():
    mean, bound, both = (less("estimators/bounds", name)[0] for name in ("KF-mean", "MHE-10", "MHE-mean"))
    stated = f"{mean:.1f} % less error by mean and variance, {bound:.1f} % by the bound, {both:.1f} % by both"
    assert stated in WORDS


@pytest.mark.parametrize(
    ("name", "methods", "verdict"),
    [
        ("examples/angles", ["UKF"], "equivalent"),
        ("examples/turning-pendulum", ["UKF+FF"], "equivalent"),
        ("examples/cstr", ["EKF+MPC", "UKF+MPC", "MHE+MPC"], "inconclusive"),
    ],
)
def test_nonlinear_filters(name, methods, verdict):
    rows = kept(name).set_index("method")
    assert {*rows.loc[methods, "verdict"]} == {verdict}


def test_a_late_camera():
    (more,) = less("examples/camera", "not known")
    assert f"{1 - more / 100:.0f} times the error where the filter does not know it" in WORDS


def test_no_rank_of_the_suite_is_used():
    assert "suite-1" not in TEXT and not re.search(r"\d+ of \d+ systems|\brank \d", TEXT)


def test_the_named_cells():
    """A student filter at 5 % outliers, and a Kalman filter with a disturbance model without noise."""
    assert "| -69.4 [-71.71, -67.01] |" in TEXT and "| -17.9 [-20.42, -15.44] |" in TEXT
