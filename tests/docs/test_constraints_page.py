"""docs/constraints.md: its commands work. The statements of docs/servo-constrained.md are those of the kept results."""

import re

import pytest
from docs.constraints_page import PAGE, PLACEMENT, SERVO, TABLES, kept, number_of
from docs.followed_page import BLOCK, comparable, follow
from docs.markdown import DOCS, PLACE

GUIDE = DOCS / "constraints.md"
TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """The page, followed in an empty directory."""
    place = tmp_path_factory.mktemp("page")
    return place, [*follow(GUIDE, place)]


@pytest.mark.page
def test_every_command_works(steps):
    place, done = steps
    assert len(done) == 3
    for step in done:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err
    assert (place / "results" / "limited" / "figures" / "rows.svg").exists()


@pytest.mark.page
def test_the_ranks_of_the_page(steps):
    (shown,) = (step for step in steps[1] if step.shown is not None)
    assert comparable(shown.out) == comparable(shown.shown)


@pytest.mark.page
def test_an_output_disturbance_is_refused_in_the_words_of_the_page(steps):
    from rmpc_bench import load_config
    from rmpc_bench.types import ConfigError

    override = "methods.input.model.disturbance.at=output"
    with pytest.raises(ConfigError) as caught:
        load_config(steps[0] / "limited.yaml", overrides=[override])
    (quoted,) = (
        text
        for language, _, text in BLOCK.findall(GUIDE.read_text("utf-8"))
        if language == "text" and "detectable" in text
    )
    assert " ".join(quoted.split()).endswith(caught.value.problems[0].message)


def test_every_table_has_a_place():
    names = [name for _, name, _ in PLACE.findall(TEXT)]
    assert sorted(names) == sorted(TABLES) and TEXT.count("<!-- begin of the table") == len(TABLES)


def test_every_figure_of_the_page_is_kept():
    figures = re.findall(r"!\[.*?\]\(\.\./(.*?)\)", TEXT)
    assert len(figures) == 2
    for figure in figures:
        assert (PAGE.parents[1] / figure).is_file(), figure


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
