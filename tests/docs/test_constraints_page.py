"""docs/constraints.md: its commands work. docs/servo-constrained.md has its tables."""

import pytest
from docs.constraints_page import PAGE, TABLES
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
    blocks = BLOCK.findall(GUIDE.read_text("utf-8"))
    (quoted,) = (text for language, _, text in blocks if language == "text" and "detectable" in text)
    assert " ".join(quoted.split()).endswith(caught.value.problems[0].message)


def test_every_table_has_a_place():
    names = [name for _, name, _ in PLACE.findall(TEXT)]
    assert sorted(names) == sorted(TABLES) and TEXT.count("<!-- begin of the table") == len(TABLES)
