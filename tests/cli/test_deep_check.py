"""Output of check --deep."""

import numpy as np
import pytest

from rmpc_bench.cli import deep_check
from rmpc_bench.diagnostics.mismatch import GainConvergence, MeanDivergence, MethodMismatch, Mismatch, NoiseScale

DIVERGENCE = MeanDivergence(np.array([0.1, 0.3]), np.array([4.0, 8.0]), np.array([0.5, 0.5]))
USUAL = MethodMismatch(0.1, NoiseScale(0.02, "measurement"), DIVERGENCE, 0.9, np.array([0.8, 0.9]), GainConvergence())


def finding(n_plants=2, confounded=None, **methods):
    """Of 40 steps of 0.1 s, methods by their name."""
    return Mismatch("servo", n_plants, 40, 0.1, methods, confounded or {})


def test_divergence():
    """One line per method: c, both parts with their range, and the second one at the scale of the noise."""
    assert deep_check.divergence_lines(finding(A=USUAL, BB=USUAL._replace(c=None))) == [
        "  divergence of the plant from the design model, a guide for the tolerance c",
        "  (10) of zenere2018 averaged over k = 0..39, mean [range] of the first 2 plants; s of the measurement noise",
        "        c    covariance part  mean part             mean part at s = 0.02",
        "    A   0.1  0.2 [0.1, 0.3]   6 [4, 8] / s^2 + 0.5  1.5e+04 [1e+04, 2e+04]",
        "    BB  -    0.2 [0.1, 0.3]   6 [4, 8] / s^2 + 0.5  1.5e+04 [1e+04, 2e+04]",
    ]


def test_models_of_different_noise():
    """Each method has its scale."""
    shown = deep_check.divergence_lines(finding(A=USUAL, B=USUAL._replace(noise=NoiseScale(0.2, "process"))))
    assert shown[1].endswith("; s of the measurement noise or s of the process noise")
    assert shown[2].endswith("  mean part at s")
    assert shown[3].endswith("  1.5e+04 [1e+04, 2e+04] (s = 0.02)") and shown[4].endswith("  150 [100, 200] (s = 0.2)")


def test_without_noise():
    """There is no number for the mean part."""
    shown = deep_check.divergence_lines(finding(A=USUAL._replace(noise=NoiseScale(None, "none"))))
    assert shown[1].endswith("; no noise, so s = 0") and shown[3].endswith(" / s^2 + 0.5")


def test_what_is_not_available():
    """A method without a divergence, a plant without a linear part, a method without a linear law."""
    nothing = MethodMismatch(
        None, NoiseScale(None, "none"), "no law", None, np.empty(0), GainConvergence(missing="no law")
    )
    shown = deep_check.divergence_lines(finding(A=USUAL, B=nothing))
    assert shown[2].endswith("mean part at s = 0.02") and shown[4] == "    B  -    not available: no law"
    assert deep_check.divergence_lines(finding(0, A=USUAL))[0].endswith(
        "the tolerance c: not available for plant servo"
    )
    assert deep_check.loop_lines(finding(A=nothing))[2].split("  ")[-3:] == ["not available"] * 2 + [
        "not available: no law"
    ]


@pytest.mark.parametrize(
    ("gain", "text", "warning"),
    [
        (GainConvergence(), "constant", ""),
        (GainConvergence(0.001, 8.5, 20.0), "within 1 % after 8.5 s", ""),
        (
            GainConvergence(0.02, 11.1, 20.0),
            "2 % off at 4 s, within 1 % after 11.1 s",
            "A: the estimator gain has not converged when the experiment ends: 2 % off at 4 s, within 1 % after 11.1 s",
        ),
        (
            GainConvergence(np.nan, None, 20.0),
            "not converged within 20 s",
            "A: the estimator gain does not converge within 20 s",
        ),
        (GainConvergence(missing="its design refuses 80 steps"), "not available: its design refuses 80 steps", ""),
    ],
)
def test_gains(gain, text, warning):
    """When they are steady, and a warning where the experiment ends before."""
    found = finding(A=USUAL._replace(gain=gain))
    assert deep_check.loop_lines(found)[2] == f"    A  0.9           0.85 [0.8, 0.9]  {text}"
    assert deep_check.warnings(found, "A") == ([warning] if warning else [])


def test_warnings():
    """Unstable loops, and comparisons of more than estimators."""
    unstable = USUAL._replace(model_radius=1.0, plant_radii=np.array([0.9, 1.25]))
    assert deep_check.warnings(
        finding(A=USUAL, B=unstable, confounded={"B": ["controller.R", "controller.Q"]}), "A"
    ) == [
        "B: the loop with the design model is not stable (spectral radius 1)",
        "B: the loop with the plants is not stable (spectral radius 1.25, 1 of 2)",
        "B differs from A in the estimator and in controller.R, controller.Q: "
        "the comparison is not of the estimators alone",
    ]
