"""claims.md and claims.json stay the same when every number changes by the rounding of another CPU."""

import json

import numpy as np
import pytest

from rmpc_bench.claims.claim import Claim, Finding, Stated
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.record import claims_table
from rmpc_bench.claims.verdict import judge

RNG = np.random.default_rng(3)
N_RUNS, N = 40, 30
BASE = RNG.lognormal(0, 0.3, N_RUNS)
METRICS = {
    "mse": {"A": 0.9 * BASE * RNG.lognormal(0, 0.05, N_RUNS), "B": BASE, "C": BASE},
    "noise": {"A": RNG.normal(0, 1, N_RUNS) * 1e-18, "B": np.ones(N_RUNS), "C": np.full(N_RUNS, 0.125)},
}
P = 30.0 * np.array([[[2.0, 0.3], [0.3, 1.0]]]) * (1 + 0.5 ** np.arange(N))[:, None, None]
SERIES = {
    "P": P,
    "cov(e)": P,  # an exact design: equal but for rounding
    "mean(e)": np.zeros((N, 2)) + 1e-30,
    "flat": np.full(N, 0.12345),  # on the border between four-digit roundings
    "wave": np.sin(np.arange(N) * np.pi / 2),  # the same largest value, again and again
    "thin": np.full((N, 2, 2), 150.0) + np.diag([0, 1.5503e-4]),  # nearly singular
    "bound": np.full(N, 1.25),
}
CHECKS = (
    "mean(mse[A]) < mean(mse[B])",
    "mean(mse[B]) <= mean(mse[C])",
    "median(mse[A]) < median(mse[B])",
    "share(mse[A] < mse[B]) > 50%",
    "ratio(mse[A], mse[B]) < 0.95",
    "mean(noise[A]) ~ 1e-2 +- 50%",
    "mean(noise[C]) < 1",
    "all(abs(cov(e[A]) - P[A]) <= 1e-9)",
    "all(abs(mean(e[A])) < [1e-9, 1e-9])",
    "abs(last(mean(e[A]))) < 1e-12",
    "max(abs(last(P[A]) - last(cov(e[A])))) < 0.1% * max(abs(last(P[A])))",
    "all(wave[A] < bound[A])",
    "all(-wave[A] > -bound[A])",
    "all(wave[A] > 0.5)",
    "all(wave[A] ~ 0 +- 2)",
    "all(flat[A] < bound[A])",
    "all(since(P[A], 2) <= at(P[A], 0))",
    "all(P[A] <= P[A] * bound[A] / 1.25)",
    "last(trace(P[A])) / last(trace(cov(e[A]))) ~ 1 +- 1e-6",
    "last(det(P[A])) > 0",
    "last(det(thin[A])) < 1",
)
CLAIMS = [
    *(Claim(check, "Fig. 1", (check,), Finding.CONFIRMED) for check in CHECKS),
    Claim("a size of 0", "Fig. 2", ("1 < 2",), stated=Stated("mean(mse[B]) - mean(mse[C])", 0.0, 0.01, "none")),
    Claim("a size", "Fig. 2", ("1 < 2",), stated=Stated("ratio(mse[A], mse[B])", 0.9, 0.5, "10 %")),
]


@pytest.fixture
def written(make_trials):
    """Return a function that writes both files, every number changed by a relative rounding of so much."""

    def write(noise, seed):
        rng = np.random.default_rng(seed)

        def other_cpu(values):
            """Rounding scales with the numbers of a sum, hence a mean around 0 does not stay at 1e-30."""
            return values * (1 + noise * rng.uniform(-1, 1, np.shape(values)))

        metrics = {name: {m: list(other_cpu(v)) for m, v in columns.items()} for name, columns in METRICS.items()}
        metrics["mse"]["C"] = metrics["mse"]["B"]  # the same computation, whatever the CPU
        series = {name: other_cpu(values) for name, values in SERIES.items()}
        series["mean(e)"] = noise * rng.uniform(-1, 1, (N, 2))
        rows = [
            ("A", name, ",".join(map(str, index)), k, 0, float(value[index]))
            for name, values in series.items()
            for k, value in enumerate(values)
            for index in np.ndindex(value.shape)
        ]
        trials = make_trials(metrics, rows)
        verdicts = [judge(claim, trials) for claim in CLAIMS]
        return claims_markdown(verdicts, informational=False), json.dumps(claims_table(verdicts), allow_nan=False)

    return write


def test_rounding_of_another_cpu_changes_nothing(written):
    """Neither a digit nor the place of an extremum nor a 0."""
    text, data = written(1e-13, 0)
    for seed in range(1, 9):
        other_text, other_data = written(1e-13, seed)
        assert other_text.splitlines() == text.splitlines()
        assert json.loads(other_data) == json.loads(data)


def test_what_is_written(written):
    """The first of equal places, 0 for what is rounding, a border rounded one way."""
    text, _ = written(1e-13, 0)
    lines = dict(line.removeprefix("- `").split("`: ", 1) for line in text.splitlines() if line.startswith("- `"))
    assert lines["all(abs(cov(e[A]) - P[A]) <= 1e-9)"] == "holds; smallest margin at k = 0, entry 0,0: 0 and 1e-09"
    assert lines["all(abs(mean(e[A])) < [1e-9, 1e-9])"] == "holds; smallest margin at k = 0, entry 0: 0 and 1e-09"
    # The same value in every run.
    assert lines["mean(noise[A]) ~ 1e-2 +- 50%"].startswith("inconclusive; 0 and 0.01")
    assert lines["all(wave[A] < bound[A])"] == "holds; smallest margin at k = 1: 1 and 1.25"
    assert lines["all(wave[A] > 0.5)"] == "does not hold; largest violation at k = 3: -1 and 0.5"
    assert lines["all(wave[A] ~ 0 +- 2)"] == (
        "holds; largest difference at k = 1: 1 and 0; equivalent within margins of 1 or more"
    )
    assert lines["last(det(thin[A])) < 1"] == "holds; 0.02325 and 1"  # 150 * 1.5503e-4, up to 1e-9 of 300 * 300
    assert "computed: `mean(mse[B]) - mean(mse[C])` is 0 [-inf, inf]\n" in text


def test_json_has_six_digits(written):
    """And no more."""
    _, data = written(1e-13, 0)
    numbers = [number for row in json.loads(data) for number in row["numbers"]]
    assert {f"{value:.6g}" for number in numbers for value in (number["left"], number["right"])} == {
        f"{value:.12g}" for number in numbers for value in (number["left"], number["right"])
    }
