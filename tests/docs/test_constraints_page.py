"""docs/constraints.md: its commands work, and its tables and statements are those of the kept results."""

import re

import pytest
from docs.constraints_page import PAGE, SERVO, TABLES, kept, number_of
from docs.followed_page import BLOCK, comparable, follow
from docs.markdown import PLACE

TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """The page, followed in an empty directory."""
    place = tmp_path_factory.mktemp("page")
    return place, [*follow(PAGE, place)]


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
    (quoted,) = (text for language, _, text in BLOCK.findall(TEXT) if language == "text" and "detectable" in text)
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
    assert number_of(clip, "mse") < number_of(qp, "mse") < 1.02 * number_of(clip, "mse")
    assert number_of(qp, "torque", "max") < number_of(clip, "torque", "max")


def test_process_noise_and_drift():
    """A drift of 100 is enough for S and not for S with more process noise; c = 3 has no runaways."""
    frame = kept(SERVO, "placement")

    def share(method, point):
        return number_of(frame[(frame["method"] == method) & (frame["model.disturbance"] == point)], "runaway")

    assert share("S", "input drift 100") == 0.0 < share("S-process", "input drift 100")
    assert share("R-c3", "no disturbance") == 0.0 < share("S", "no disturbance") < share("R1", "no disturbance")
    assert share("S", "input drift 1") > 0.1
