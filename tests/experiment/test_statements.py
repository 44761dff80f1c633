"""Claims of a sweep, before anything has run: what they are made at, and what is wrong with them."""

import pytest
from small_experiment import KEYS, write

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError

HP, C = "controller.Hp", "methods.R-MPC.estimator.c"
HORIZONS = f"{{grid: {{{HP}: [10, 12]}}}}"
SWEEP = f"{{grid: {{{C}: [0.1, 1], {HP}: {{long: 12, short: 10}}}}, exclude: [{{{C}: 1, {HP}: long}}]}}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with one claim about a sweep."""

    def claim(check, at=None, sweep=SWEEP, **keys):
        made_at = f"at: {at}, " if at else ""
        return load_config(write(tmp_path, sweep=sweep, claims=f'[{{says: s, {made_at}check: "{check}"}}]', **keys))

    return claim


@pytest.mark.parametrize(
    ("at", "points", "pooled"),
    [
        (f"{{{C}: 0.1, {HP}: long}}", ({C: "0.1", HP: "long"},), False),
        (f"{{{C}: 1.0}}", ({C: "1"},), False),
        (f"[{{{C}: 1}}, {{{C}: 1e-1, {HP}: short}}]", ({C: "1"}, {C: "0.1", HP: "short"}), False),
        ("all", (), True),
    ],
)
def test_where_a_claim_is_made(load, at, points, pooled):
    """At one point, at each of several readings, or over all points together."""
    [claim] = load("mean(mse[R-MPC]) < 1", at).claims
    assert (claim.at, claim.pooled) == (points, pooled)


@pytest.mark.parametrize(
    ("check", "at"),
    [
        (f"mean(mse[S-MPC, {HP}=long]) < mean(mse[S-MPC, {HP} = short])", None),
        (f"mean(mse[R-MPC, {C}=1]) < 1", None),  # with c = 1 only one is left
        (f"mean(mse[R-MPC, {C}=1e0, {HP}=short]) < 1", None),
        (f"mean(mse[R-MPC, {HP}=long]) < mean(mse[S-MPC])", f"{{{C}: 0.1, {HP}: short}}"),  # the term's own counts
        (f"mean(mse[R-MPC, {C}=0.1]) < n_failed[S-MPC]", f"{{{HP}: short}}"),  # what it leaves open is taken from at
        ("last(trace(P[R-MPC])) < 1", f"{{{C}: 0.1, {HP}: short}}"),
        ("1 < 2", None),
    ],
)
def test_terms_that_name_one_point(load, check, at):
    """By themselves, with the point of the claim, or because the method is the same at all that are left."""
    assert load(check, at).claims[0].check == (check,)


def test_a_method_that_depends_on_nothing_needs_no_point(load):
    """Its trials are the same at all of them; those of the other are not."""
    one = f"{{grid: {{{C}: [0.1, 1]}}}}"
    assert load("mean(mse[S-MPC]) < 1", sweep=one).claims
    with pytest.raises(ConfigError, match=r"mse\[R-MPC\] may be at any of 2 points"):
        load("mean(mse[R-MPC]) < 1", sweep=one)


OF = "mean(mse[%s]) < 1"
CASES = [
    # check, at, path, message
    (OF % "S-MPC", None, "check", "mse[S-MPC] may be at any of 3 points of the sweep: name one, as mse[S-MPC, "),
    (OF % f"R-MPC, {C}=0.1", None, "check", f"at any of 2 points of the sweep: name one, as mse[R-MPC, {HP}="),
    (OF % "R-MPC", f"{{{C}: 0.1}}", "check", "mse[R-MPC] may be at any of 2 points"),
    (OF % f"S-MPC, {HP}=medium", None, "check", f"{HP} has no value medium in the sweep (it has long, short)"),
    (OF % f"S-MPC, {HP}=12", None, "check", f"{HP} has no value 12 in the sweep (it has long, short)"),
    (OF % "S-MPC, controller.Hq=10", None, "check", f"did you mean '{HP}'?"),
    (OF % f"R-MPC, {C}=1, {HP}=long", None, "check", "the sweep has no such point"),
    (OF % "S-MPC, controller.Hp", None, "check", "mse[...] is mse[METHOD, path=value, ...]"),
    (OF % "S-MPC", f"{{{HP}: 12}}", "at", f"{HP} has no value 12 in the sweep (it has long, short)"),
    (OF % "S-MPC", "{controller.Hq: 12}", "at", f"did you mean '{HP}'?"),
    (OF % "S-MPC", f"[{{{C}: 1}}, {{{C}: 1, {HP}: long}}]", "at", "the sweep has no such point"),
    ("1 < 2", "some", "at", "must be a mapping from paths to values, a list of those, or 'all'"),
    ("1 < 2", "[3]", "at", "must be a mapping from paths to values"),
    ("1 < 2", "[]", "at", "must name at least one point"),
    ("1 < 2", "{}", "at", "must be a mapping from paths to values"),
    # what no judgement could be made of later
    (f"mean(mse[S-MPC, {HP}=long]) < mean(mse[R-MPC])", "all", "check",
     "the terms speak of different numbers of points"),
    ("last(trace(P[R-MPC])) < 1", "all", "check", "P[R-MPC] is a series, of one point: name one, as P[R-MPC, "),
    (OF % "S-MPC", "all", "check", "mse[S-MPC] is the same at several points, and would count more than once"),
]  # fmt: skip


@pytest.mark.parametrize(("check", "at", "key", "message"), CASES)
def test_one_mistake_is_reported_once_at_its_place(load, check, at, key, message):
    """At the check or at `at`, with the way out."""
    with pytest.raises(ConfigError) as caught:
        load(check, at)
    line = f'claims: [{{says: s, {f"at: {at}, " if at else ""}check: "'
    [problem] = caught.value.problems
    assert problem.path.removeprefix("claims.0.").split(".")[0] == key and message in problem.message
    assert problem.line == len(KEYS) + 2
    if key == "check":
        assert problem.column == len(line)
    else:
        assert problem.column >= line.index("at: ") + 5


def test_the_size_is_checked_like_a_check(load, tmp_path):
    """Its expression must speak of one point, too."""
    stated = "[{says: s, check: '1 < 2', stated: {of: 'mean(mse[S-MPC])', value: 1}}]"
    with pytest.raises(ConfigError, match=r"claims.0.stated.of: mse\[S-MPC\] may be at any of 2 points"):
        load_config(write(tmp_path, sweep=HORIZONS, claims=stated))


def test_points_without_a_sweep(load):
    """There is none to name."""
    for check, at in ((OF % "S-MPC", f"{{{HP}: 10}}"), (OF % f"S-MPC, {HP}=10", None), (OF % "S-MPC", "all")):
        with pytest.raises(ConfigError) as caught:
            load(check, at, sweep=None)
        [problem] = caught.value.problems
        assert "nothing is swept" in problem.message


@pytest.mark.parametrize("value", ["[0, 0, 0, 0]", "{gaussian: {std: 1}}", "{x: 1}"])
def test_the_way_out_can_be_taken(load, value):
    """What a message offers for a value that is a list or a component is a claim that loads."""
    sweep = f"{{grid: {{initial.x: [{value}, 3], seed: [1, 2]}}}}".replace(
        "initial.x: [{x: 1}, 3]", "initial: [{x: 1}, {}]"
    )
    with pytest.raises(ConfigError) as caught:
        load(OF % "S-MPC", sweep=sweep)
    message = caught.value.problems[0].message
    assert "may be at any of 4 points" in message
    if "name one, as mse[" in message:
        load(OF % message.split("name one, as mse[")[1].split("], or give")[0], sweep=sweep)
    path = "initial" if value == "{x: 1}" else "initial.x"
    assert load(OF % "S-MPC", f"{{{path}: {value}, seed: 2}}", sweep=sweep).claims[0].at


def test_the_names_of_a_zip_are_points(load):
    """A claim may name one, or the value behind it."""
    sweep = f"{{zip: {{name: [ours, printed], {HP}: [10, 12]}}}}"
    for check, at in (
        (f"mean(mse[S-MPC, name=ours]) < mean(mse[S-MPC, {HP}=12])", None),
        (OF % "R-MPC", "[{name: ours}, {name: printed}]"),
    ):
        assert load(check, at, sweep=sweep).claims
    with pytest.raises(ConfigError, match=r"name has no value theirs in the sweep \(it has ours, printed\)"):
        load(OF % "R-MPC", "{name: theirs}", sweep=sweep)


def test_claims_are_read_once(load):
    """Not at every point."""
    with pytest.raises(ConfigError) as caught:
        load("mean(mes[S-MPC]) < 1", f"{{{HP}: short, {C}: 1}}")
    assert [problem.message.split(";")[1].strip() for problem in caught.value.problems] == ["did you mean 'mse'?"]
