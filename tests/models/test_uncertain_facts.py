"""What is said of an uncertain linear system: the published numbers of the benchmarks, and what is left out."""

import numpy as np
import pytest

from rmpc_bench.models.uncertain_system import facts, uncertain_system

A = [[0.0, -0.5], [1.0, 1.0]]
SOUTO = dict(  # souto2011, (84)
    A=A, Bw=[[-6.0], [1.0]], C=[[-100.0, 10.0]], H_A=[[0.0], [10.0]], H_C=50.0, G_x=[[0.1, 0.03]],
    H_Bw=[[0.0], [10.0]], G_w=0.01, H_Dv=100.0, G_v=1.0,
)  # fmt: skip
XIE = dict(A=A, Bw=[[-6.0], [1.0]], C=[[-100.0, 10.0]], Dv=1.0, H_A=[[0.0], [10.0]], G_x=[[0.0, 0.03]])
SAYED = dict(
    A=[[0.9802, 0.0196], [0.0, 0.9802]], Bw=1.0, C=[[1.0, -1.0]], Dv=1.0, H_A=[[0.0198], [0.0]], G_x=[[0.0, 5.0]]
)
UNIFORM = {"x": (0.0, 1 / 3), "w": (0.0, 1 / 3), "v": (0.0, 1 / 3)}


def said(law=None, **given):
    """Facts of a system by their labels."""
    found = facts(uncertain_system(5, given), law)
    assert all(isinstance(part, str) and part for fact in found for part in fact)
    return dict(found)


def test_everything_of_the_benchmark():
    """The whole text, in its order; numbers of the reference study, section 5, and a zero exactly at 1."""
    assert facts(uncertain_system(5, SOUTO), UNIFORM) == [
        (
            "sizes",
            "nx = 2 states, nu = 1 input (without effect), ny = 1 output\n"
            "nw = 1 process noise, nv = 1 measurement noise\n"
            "F_x is 1 x 1, F_w is 1 x 1, F_v is 1 x 1",
        ),
        ("A", "0  -0.5\n1     1"),
        ("Bw", "-6\n 1"),
        ("C", "-100  10"),
        ("H_A", " 0\n10"),
        ("H_C", "50"),
        ("G_x", "0.1  0.03"),
        ("H_Bw", " 0\n10"),
        ("G_w", "0.01"),
        ("H_Dv", "100"),
        ("G_v", "1"),
        ("zero", "B, Bv, Dw, Dv, H_Dw, H_Bv"),
        ("spectral radius of A", "0.707107: stable without uncertainty"),
        (
            "uncertain loop",
            "H-infinity norm of G_x (zI - A)^-1 H_A: 1.00458, reached at 0.828906 rad per step\n"
            "quadratically stable: no; stable if F_x is scaled by less than 0.995441",
        ),
        (
            "mean square",
            "radius 0.585939: the second moments of x converge\nwhite F_x, entries of mean 0 and variance 0.333333",
        ),
        (
            "zeros from w to y",
            "1 (on the unit circle)\n"
            "zeros on the unit circle: a predictor designed without measurement noise has no stable limit,\n"
            "and with little measurement noise its Riccati recursion converges slowly",
        ),
    ]


def test_other_benchmarks():
    """xie1994 is quadratically stable with room to spare, by hand 0.6 sqrt(2); sayed2001 whatever its uncertainty."""
    xie, sayed = said(**XIE), said(**SAYED)
    assert "G_x (zI - A)^-1 H_A: 0.848528," in xie["uncertain loop"]
    assert "quadratically stable: yes; stable if F_x is scaled by less than 1.17851" in xie["uncertain loop"]
    assert xie["zeros from w to y"].startswith("1 (on the unit circle)\n")
    assert sayed["uncertain loop"].splitlines() == [
        "H-infinity norm of G_x (zI - A)^-1 H_A: 0",
        "quadratically stable: yes; stable if F_x is scaled by any factor",
    ]
    assert sayed["zeros from w to y"] == "none"


@pytest.mark.parametrize(
    ("law", "text"),
    [
        ({"x": (0.5, 1 / 12)}, "radius 0.764236: the second moments of x converge"),
        ({"x": (0.0, 9.0)}, "do not converge"),
        ({"x": (1.0, 0.0)}, "radius 1: the second moments of x do not converge"),  # A + H_A G_x turns, |lambda| = 1
    ],
)
def test_mean_square_of_other_laws(law, text):
    """U[0,1] of the reference study, section 5; a large variance; F = 1 for ever."""
    assert text in said(law, **SOUTO)["mean square"]


def test_what_is_not_there_is_not_said():
    """No law of F_x, no mean square; no uncertainty, no loop; no process noise, no zeros."""
    assert "mean square" not in said(**SOUTO) and "mean square" not in said({"w": (0.0, 1.0)}, **SOUTO)
    plain = said(UNIFORM, A=A, B=[[1.0], [0.0]], C=[[1.0, 0.0]], Dv=1.0)
    assert list(plain) == ["sizes", "A", "B", "C", "Dv", "zero", "spectral radius of A"]
    assert plain["sizes"].splitlines() == [
        "nx = 2 states, nu = 1 input, ny = 1 output",
        "nw = 1 process noise (without effect), nv = 1 measurement noise",
        "no uncertainty",
    ]


def test_a_system_that_is_not_stable():
    """No factor of the uncertainty helps, whether the loop sees the mode or not."""
    seen = said(A=[1.0, 0.5], C=[[1.0, 0.0]], H_A=[[1.0], [1.0]], G_x=[[1.0, 0.0]])
    hidden = said(A=[1.0, 0.5], C=[[1.0, 0.0]], H_A=[[1.0], [1.0]], G_x=[[0.0, 1.0]])
    assert seen["spectral radius of A"] == "1: not stable without uncertainty"
    assert seen["uncertain loop"].startswith("H-infinity norm of G_x (zI - A)^-1 H_A: infinite\n")
    assert hidden["uncertain loop"].startswith("H-infinity norm of G_x (zI - A)^-1 H_A: 2, reached at 0 rad per step\n")
    for text in (seen["uncertain loop"], hidden["uncertain loop"]):
        assert text.endswith("\nquadratically stable: no, not even without uncertainty")


def test_a_system_that_varies():
    """The matrices that do, what they are at k = 0, and that the rest is of k = 0."""
    varying = np.array(A) * np.linspace(1.0, 2.0, 6)[:, None, None]
    found = said(UNIFORM, **{**SOUTO, "A": varying})
    constant = said(UNIFORM, **SOUTO)
    assert found.pop("A") == "varies with k; at k = 0\n0  -0.5\n1     1"
    assert found.pop("at k = 0") == "the following results refer to the matrices at k = 0"
    assert found == {label: text for label, text in constant.items() if label != "A"}
    labels = [label for label, _ in facts(uncertain_system(5, {**SOUTO, "A": varying}))]
    assert labels.index("at k = 0") == labels.index("spectral radius of A") - 1


def test_zeros_in_words():
    """A pair counts once, by its upper one; several on the circle are marked, and explained once."""
    Bw, C = [[0.0], [0.0], [0.0], [1.0]], [[1.0, -1.2, 1.2, -1.0]]  # (1 - z)(1 - 0.2 z + z^2) in companion form
    companion = np.eye(4, k=1).tolist()
    assert said(A=companion, Bw=Bw, C=C)["zeros from w to y"].splitlines() == [
        "0.1 +- 0.994987j (on the unit circle), 1 (on the unit circle)",
        "zeros on the unit circle: a predictor designed without measurement noise has no stable limit,",
        "and with little measurement noise its Riccati recursion converges slowly",
    ]
    inside = said(A=companion, Bw=Bw, C=[[0.25, 0.0, 1.0, 0.0]])
    assert inside["zeros from w to y"] == "0 +- 0.5j"


def test_six_digits_in_columns():
    """Columns are flushed right, each as wide as it must be; nothing is minus zero."""
    found = said(A=[[1 / 3, -0.0], [-1e-7, 12345.678]], C=[[1.0, 0.0]])
    assert found["A"] == "0.333333        0\n  -1e-07  12345.7"
