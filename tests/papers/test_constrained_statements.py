"""What docs/servo-constrained.md says of the kept results of configs/servo-constrained and zenere2018/rivals."""

import pytest
from docs.constraints_page import PLACEMENT, SERVO, kept, number_of


@pytest.mark.parametrize("name", ["S exact", "R1 exact", "RS exact", "S+input exact"])
def test_no_program_fails(name):
    """The solver cannot show the problem."""
    frame = kept(SERVO, "clip-against-qp")
    assert number_of(frame[frame["method"] == name], "qp_failed", "max") == 0.0


@pytest.mark.parametrize("name", ["S", "R1", "RS", "S+input"])
def test_the_quadratic_program_tracks_worse_and_lowers_the_torque(name):
    frame = kept(SERVO, "clip-against-qp")
    clip, qp = (frame[frame["method"] == f"{name} {controller}"] for controller in ("clip", "qp"))
    assert 1.014 < number_of(qp, "mse") / number_of(clip, "mse") < 1.0195
    assert [round(number_of(each, "torque", "max")) for each in (clip, qp)] == [271, 256]


def test_the_exact_penalty_with_a_disturbance_at_the_input():
    frame = kept(SERVO, "clip-against-qp")
    errors = [number_of(frame, "mse", method=f"S+input {each}") for each in ("exact", "clip")]
    assert round(100 * errors[0] / errors[1] - 100) == 16


def test_process_noise_and_drift():
    """A drift of 100 is enough for S and not for S with more process noise; c = 3 has no runaways."""
    frame = kept(SERVO, "placement")

    def share(method, point):
        return number_of(frame, "runaway", method=method, **{PLACEMENT: point})

    assert share("S", "input drift 100") == 0.0 < share("S-process", "input drift 100")
    assert share("R-c3", "no disturbance") == 0.0 < share("S", "no disturbance") < share("R1", "no disturbance")
    assert 200 * share("S", "input drift 1") == pytest.approx(29)


def counts_of(name, column):
    """Return method -> point -> number of runaways of 200."""
    rows = kept(SERVO, name).query("metric == 'runaway'")
    return {
        method: {str(point): round(200 * share) for point, share in zip(mine[column], mine["mean"], strict=True)}
        for method, mine in rows.groupby("method")
    }


def test_penalties_between():
    counts = counts_of("penalty", "controller.soft.shaft_torque.linear")
    assert not any(counts["S+input"].values())
    for name in ("S", "R1"):
        assert [bool(count) for count in counts[name].values()] == [float(each) > 0.003 for each in counts[name]]


def test_horizons():
    counts = counts_of("horizon", "name")
    longer = [[counts[name][f"Hp {each}"] for each in ("20 Hu 3", "20 Hu 5", "30 Hu 10")] for name in ("S", "R1")]
    assert [(min(each), max(each)) for each in longer] == [(19, 25), (46, 58)]
    assert all(each["3 torque steps"] == each["Hp 10 Hu 3"] for each in counts.values())


def test_a_tenth_of_the_noise():
    above = kept(SERVO, "noise").query("metric == 'above' and noise == 's=0.1'")
    shares = above[above["controller"].isin(["qp", "torque 0.03"])]["mean"]
    assert len(shares) == 6 and [round(100 * each) for each in (min(shares), max(shares))] == [21, 26]


def test_rivals():
    """How much better tuned filters are without noise, in per cent."""
    frame = kept("zenere2018", "rivals").query("name == 's=0'")
    robust = number_of(frame, "mse", method="R-tuned")
    gains = [100 - 100 * number_of(frame, "mse", method=each) / robust for each in ("S-process", "S-input", "S-load")]
    assert [round(each, 1) for each in (min(gains), max(gains))] == [4.5, 6.0]
    assert round(100 - 100 * robust / number_of(frame, "mse", method="R-MPC1")) == 2
