"""Claims of a sweep, before anything has run: what they are made at, and what is wrong with them."""

import pytest
from small_experiment import KEYS, write

from rmpc_bench import load_config
from rmpc_bench.config.claim_keys import ClaimKeys
from rmpc_bench.config.claims import read_claims
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.sections import Keys
from rmpc_bench.config_file.tree import Map, Mark
from rmpc_bench.types import ConfigError, ResultLayout

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
        (f"{{{C}: 100%}}", ({C: "100%"},), False),
        (f"[{{{C}: 1}}, {{{C}: 1e-1, {HP}: short}}]", ({C: "1"}, {C: "0.1", HP: "short"}), False),
        ("all", (), True),
    ],
)
def test_where_a_claim_is_made(load, at, points, pooled):
    """At one point, at each of several interpretations, or over all points together."""
    [claim] = load("mean(mse[R-MPC]) < 1", at).claims
    assert (claim.at, claim.pooled) == (points, pooled)


@pytest.mark.parametrize(
    ("check", "at"),
    [
        (f"mean(mse[S-MPC, {HP}=long]) < mean(mse[S-MPC, {HP} = short])", None),
        (f"mean(mse[R-MPC, {C}=1]) < 1", None),  # with c = 1 only one is left
        (f"mean(mse[R-MPC, {C}=1e0, {HP}=short]) < 1", None),
        (f"mean(mse[R-MPC, {C}=10%, {HP}=short]) < 1", None),
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
     "the terms are about different numbers of points"),
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
    """Its expression must be about one point, too."""
    stated = "[{says: s, check: '1 < 2', stated: {of: 'mean(mse[S-MPC])', value: 1, tolerance: 0}}]"
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


@pytest.fixture
def messages():
    """Return a function that gives the errors of one check, for an experiment with the series of a layout."""

    def errors(check, series=(), metrics=("mse",), points=(), pooled=False, arrays=None, end=1.0, evaluate=("runs",)):
        claims = [ClaimKeys(says="s", check=check, at="all" if pooled else None)]
        draft = DraftConfig(Map(mark=Mark("", 1, 1)), keys=Keys(evaluate=evaluate), claims=claims)
        coordinates, trials = [{"plant.from": name} for name in points], [{"A": name, "B": name} for name in points]
        if arrays is not None and not points:
            coordinates, trials = [{}], [{"A": "a", "B": "b"}]
        shapes = dict.fromkeys(("P", *series), (2, 2)) | {
            name: (2, 2) for own in (arrays or {}).values() for name in own
        }
        layout = ResultLayout(
            methods=("A", "B"),
            metrics=metrics,
            points=tuple(coordinates),
            trials=tuple(trials),
            has_runs="runs" in evaluate,
            end=end,
            series=shapes,
            arrays=arrays or {},
        )
        read_claims(draft, layout)
        assert all(each.path == "claims.0.check" for each in draft.problems)
        return [each.message for each in draft.problems]

    return errors


MOMENTS = ("mean(e)", "cov(e)")
WAY_OUT = "is not there: ensemble moments need `evaluate: [runs, moments]`"
ALONE = "of the signal e[A] only moments over the runs are known: mean(e[A]), var, std or cov"
UNKNOWN = "is not a known metric or series of this configuration"


@pytest.mark.parametrize(
    ("check", "series", "expected"),
    [
        ("all(var(e[A]) <= diag(P[A]))", MOMENTS, []),
        ("at(mean(e[A]), 5) > at(trace(cov(e[B])), 5) / max(std(e[A]))", MOMENTS, []),
        ("all(var(e[A]) <= diag(P[A]))", (), [f"var(e[A]) {WAY_OUT}"]),
        ("all(mean(e[A]) < var(e[A]))", ("mean(e)",), [f"var(e[A]) {WAY_OUT}"]),
        ("all(std(e[A]) < cov(e[A]))", ("mean(e)",), [f"cov(e[A]) {WAY_OUT}", f"std(e[A]) {WAY_OUT}"]),
        ("all(mean(x[A]) < 1)", MOMENTS, [f"mean(x[A]) {WAY_OUT}"]),
        ("last(e[A]) < 1", MOMENTS, [ALONE]),
        ("mean(2 * e[A]) < last(e[A])", (), [ALONE]),
        ("cov(P[A]) < 1", MOMENTS, ["cov needs a signal (x, x_hat, e, where no metric has the name), got P[A]"]),
        ("mean(e[C]) < 1", MOMENTS, ["'C' is not a known method; known: A, B"]),
        ("cov(ee[A]) < 1", MOMENTS, [f"'ee' {UNKNOWN}; did you mean 'e'?"]),
        ("cov(zzz[A]) < 1", MOMENTS, [f"'zzz' {UNKNOWN}; known: mse, n_failed, P, e"]),
    ],
)
def test_signals(messages, check, series, expected):
    """Known where there is the series they need; each mistake is reported once, with the way out."""
    assert messages(check, series) == expected


def test_a_metric_with_the_name_of_a_signal(messages):
    """It is a column, and has no covariance."""
    assert messages("mean(e[A]) < max(e[A])", metrics=("e",)) == []
    [message] = messages("cov(e[A]) < 1", MOMENTS, metrics=("e",))
    assert "where no metric has the name" in message


def test_signals_at_points(messages):
    """Of one point, named in the term or by the claim."""
    assert messages("all(mean(e[A, plant.from=a]) < 1)", MOMENTS, points="ab") == []
    [message] = messages("all(mean(e[A]) < 1)", MOMENTS, points="ab")
    assert "e[A] may be at any of 2 points of the sweep: name one, as e[A, plant.from=a]" in message
    [message] = messages("all(mean(e[A]) < 1)", MOMENTS, points="ab", pooled=True)
    assert "e[A] is a series, of one point: name one, as e[A, plant.from=a]" in message


ARRAYS = {
    "A": {"P": (21, 2, 2), "c": (1, 2, 2), "R": (21, 3, 3), "v": (21,), "mean(e)": (21, 2), "cov(e)": (21, 2, 2)},
    "B": {"P": (21, 2, 2), "K": (20, 2, 1), "mean(e)": (21, 2), "cov(e)": (21, 2, 2)},
}


@pytest.mark.parametrize(
    ("check", "expected"),
    [
        ("at(var(e[A]), 5000) < 1", "at needs a sample from 0 to 20"),
        ("all(since(P[A], 21) < 1)", "since needs a sample from 0 to 20"),
        ("at(since(v[A], 5), 4) < 1", "at needs a sample from 5 to 20"),
        ("entry(mean(e[A]), 4) < 1", "a place that counts from 0"),
        ("all(diag(P[A]) < P[A])", "entries of shapes (2,) and (2, 2) cannot be combined"),
        ("all(mean(e[A]) < [1, 2, 3])", "entries of shapes (2,) and (3,) cannot be combined"),
        ("share(v[A] < mse[A]) > 0.5", "a column over runs and a series over k cannot be combined entry by entry"),
        ("all(K[B] < entry(diag(P[B]), 0))", "series of 20 and 21 samples (k = 0 to 19 and 0 to 20)"),
        ("all(K[A] < 1)", "K[A] is neither a metric nor a stored series"),
        ("all(excess(P[A], R[A]) <= 1)", "entries of shapes (2, 2) and (3, 3) cannot be combined"),
        ("last(det(K[B])) < 1", "det needs square matrices, got entries of shape (2, 1)"),
        ("share(last(v[A]) < 1) > 0.5", "share needs columns over runs or series over k"),
        ("last(mse[A]) < 1", "last needs a series over k"),
        ("slope(c[A]) < 1", "slope needs two samples"),
        ("quantile(mse[A], 150%) < 1", "the second argument of quantile is a number from 0 to 1"),
        ("1 < mean(mse[A]) < at(v[A], 21)", "at needs a sample from 0 to 20"),
        ("distance(mean(e[A]), 0, R[A]) < 1", "distance needs a vector and a matrix"),
    ],
)
def test_what_no_results_could_answer(messages, check, expected):
    """Found by the shapes alone, once, with the statement it is about."""
    [message] = messages(check, arrays=ARRAYS)
    assert expected in message
    assert message.split(": ")[0] in check


@pytest.mark.parametrize(
    "check",
    [
        "at(var(e[A]), 20) < 1 < last(trace(P[A]))",
        "at(P[A], 20) ~ [[1, 2], [2, 3]] +- 0.05",
        "all(var(e[A]) <= diag(P[A]))",
        "all(excess(cov(e[A]), P[A]) <= 1)",
        "all(P[A] < c[A])",  # which is the same at every k
        "at(c[A], 5000) < 1",
        "all(diag(since(P[A], 7)) < last(diag(P[A])))",
        "share(distance([mse[A], mse[B]], last(mean(e[A])), last(P[A])) <= 3) < 99%",
        # what depends on the numbers
        "all(excess(P[A], P[A] - 2 * c[A]) < 1)",
        "ratio(mse[A] - 1, mse[B]) < 1",
        "1 / (last(v[A]) - 1) < slope(v[A]) / slope(v[A])",
        "at(v[A], 30 * n_failed[A]) < 1",
        "entry(mean(e[A]), 2 * n_failed[B]) < 1",
        "quantile(mse[A], 2 * mean(mse[B])) < 1",
        "det(last(R[A])) / n_failed[A] < std(mse[A])",
    ],
)
def test_what_some_results_could_answer(messages, check):
    """Ones may not, but that is no mistake of the claim."""
    assert messages(check, arrays=ARRAYS) == []


def test_smoke_runs_are_shorter_than_their_claims(messages):
    """What is beyond their end is there at full size; shapes are the same."""
    for check in ("at(v[A], 5000) < 1", "slope(since(v[A], 20)) < 1", "all(upto(P[A], 30) < 1)"):
        assert len(messages(check, arrays=ARRAYS)) == 1
        assert messages(check, arrays=ARRAYS, end=0.0) == []
    [message] = messages("all(mean(e[A]) < [1, 2, 3])", arrays=ARRAYS, end=0.0)
    assert "cannot be combined" in message


def test_shapes_at_points(messages):
    """Known where the method is what it is at the first point; columns are known everywhere."""
    assert len(messages("at(v[A, plant.from=a], 21) < 1", points="ab", arrays=ARRAYS)) == 1
    assert messages("at(v[A, plant.from=b], 21) < 1", points="ab", arrays=ARRAYS) == []
    [message] = messages("mean([mse[A], [1, 2]]) < 1", points="ab", pooled=True, arrays=ARRAYS)
    assert "a list has numbers, or rows" in message
    [message] = messages("share([mse[A], mse[B]] < [1, 2, 3]) < 1", points="ab", pooled=True, arrays=ARRAYS)
    assert "entries of shapes (2,) and (3,)" in message


def test_without_runs_there_are_no_columns(messages):
    """A count of failures would be 0 in vain."""
    for check in ("mean(mse[A]) < at(v[A], 3)", "n_failed[B] == 0"):
        message = "no runs are evaluated; add `runs` to `evaluate`"
        assert messages(check, arrays=ARRAYS, evaluate=("moments",)) == [message]
    assert messages("all(var(e[A]) <= diag(P[A]))", arrays=ARRAYS, evaluate=("moments",)) == []


@pytest.mark.parametrize(
    ("check", "message"),
    [
        ("at(trace(P[S-MPC]), 11) < 1", "at needs a sample from 0 to 10"),
        ("all(diag(P[S-MPC]) < [1, 2])", "entries of shapes (4,) and (2,) cannot be combined"),
    ],
)
def test_shapes_of_a_configuration(load, check, message):
    """With file, line and column; the last sample is there."""
    with pytest.raises(ConfigError) as caught:
        load(check, sweep=None)
    [problem] = caught.value.problems
    assert message in problem.message and problem.path == "claims.0.check"
    assert (problem.line, problem.column) == (len(KEYS) + 1, len('claims: [{says: s, check: "'))
    assert load("at(trace(P[S-MPC]), 10) < 1", sweep=None).claims


def test_the_shape_of_a_size(tmp_path):
    """It is one number."""
    stated = "[{says: s, check: '1 < 2', stated: {of: 'last(P[S-MPC])', value: 1, tolerance: 0}}]"
    with pytest.raises(ConfigError, match=r"claims.0.stated.of: the size: the expression is not one number"):
        load_config(write(tmp_path, claims=stated))


@pytest.mark.parametrize(
    ("check", "reason"),
    [
        ("mean(mse[R-MPC]) / 0 > 1", "division by 0"),
        ("mean(mse[R-MPC]) / (1 - 1) > 1", "division by 0"),
        ("mean(mse[R-MPC]) ~ 1 +- -0.1", "is negative"),
        ("mean(mse[R-MPC]) ~ 1 +- -5%", "is negative"),
    ],
)
def test_what_no_results_can_answer_is_refused(tmp_path, check, reason):
    """Before a run is computed."""
    with pytest.raises(ConfigError, match=reason):
        load_config(write(tmp_path, claims=f'[{{says: s, check: "{check}"}}]'))
