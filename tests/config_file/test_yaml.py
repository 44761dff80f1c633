"""YAML 1.2: texts that are read, each error with its place, and plain data that is written and read back."""

import copy
import math
import pickle
import subprocess
import sys

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rmpc_bench.config_file.tree import Items, Map, Mark, assign, locate, locate_key, merge, plain, scalar
from rmpc_bench.config_file.yaml import dump, load, parse, parse_override
from rmpc_bench.types import ConfigError

CONFIG = """\
version: 1
plant: {kind: servo, perturb: {R: 1 + eps}}
methods:
  S-MPC:
    estimator: {kind: kalman}
  R.1:
    estimator: {kind: robust-kalman, c: 1e-1}
metrics: [mse, input_power]
claims:
  - says: first
  - says: second
"""


def problems(text):
    """Return (line, column, path, message) of everything wrong with a text."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "f.yaml")
    assert {problem.file for problem in caught.value.problems} == {"f.yaml"}
    return [(problem.line, problem.column, problem.path, problem.message) for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *((word, None) for word in ("null", "Null", "NULL", "~")),
        *((word, True) for word in ("true", "True", "TRUE")),
        *((word, False) for word in ("false", "False", "FALSE")),
        *(("12", 12), ("-0", 0), ("+7", 7), ("007", 7), ("0o17", 15), ("0xFf", 255)),
        *(("1e-3", 1e-3), (".5", 0.5), ("1.", 1.0), ("-1.5E+3", -1500.0), ("1e5", 1e5)),
        *((".inf", math.inf), ("-.Inf", -math.inf), ("+.INF", math.inf)),
        *(('"1"', "1"), ("'true'", "true"), ('""', ""), ("!!str 12", "12"), ("!!float 1", 1.0), ('!!int "3"', 3)),
        *(("|\n  12\n", "12\n"), (">-\n  null\n", "null"), ("!!null ''", None)),
        *((word, word) for word in ("yes", "no", "on", "off", "y", "nUll", "tRUE", "1_000", "2*pi", "+-10%", "10%")),
        *((word, word) for word in ("2018-04-18", "12:30:45", "0b11", "0O17", "-0x1", "1e", ".", "e5", ".inF", "=")),
        *(("<<", "<<"), ("١", "١"), ("[1, a]", [1, "a"]), ("{a: }", {"a": None})),
    ],
)
def test_core_schema(text, value):
    """Scalars have the values and types of YAML 1.2."""
    result = parse(text, "f")
    assert result == value
    assert type(plain(result)) is type(value)


def test_nan_is_read():
    """Refusing it is the schema's business."""
    assert all(math.isnan(parse(word, "f")) for word in (".nan", ".NaN", ".NAN"))


def test_keys_are_text_and_nothing_is_special():
    """Keys stay as written; << merges nothing; aliases may be keys and values."""
    assert parse('1: a\n1.0: b\ntrue: c\n~: d\n"": e\n<<: {x: 1}\n', "f") == {
        **{"1": "a", "1.0": "b", "true": "c", "~": "d", "": "e"},
        "<<": {"x": 1},
    }
    assert parse("&k a: &v [1, 2]\nb: *v\nc: {*k : 3}\n!!str 5: 6\n", "f") == {
        **{"a": [1, 2], "b": [1, 2], "c": {"a": 3}, "5": 6}
    }
    assert parse("[&a x, &a y, *a]", "f") == ["x", "y", "y"]


def test_marks():
    """Every key and value knows its line and column."""
    tree = parse(CONFIG, "c.yaml")
    assert isinstance(tree, Map) and isinstance(tree["metrics"], Items)
    assert tree.mark == ("c.yaml", 1, 1)
    assert tree.key_marks["methods"] == ("c.yaml", 3, 1)
    assert tree.value_marks["methods"] == tree["methods"].mark == ("c.yaml", 4, 3)
    assert tree["plant"].mark == ("c.yaml", 2, 8)
    assert tree["plant"]["perturb"].value_marks["R"] == ("c.yaml", 2, 35)
    assert tree["metrics"].value_marks == [("c.yaml", 8, 11), ("c.yaml", 8, 16)]
    assert tree["claims"][1].key_marks["says"] == ("c.yaml", 11, 5)
    assert parse("a: 1\r\nb: ü1\r\nc: 2", "f").key_marks["c"] == ("f", 3, 1)
    # line separators of Unicode are no line ends for an editor
    assert parse('a: "x\u2028y\x85z"\nb: 1', "f").key_marks["b"] == ("f", 2, 1)
    assert parse("\ufeffa: 1", "f").value_marks["a"] == ("f", 1, 4)


@pytest.mark.parametrize("clone", [copy.copy, copy.deepcopy, lambda tree: pickle.loads(pickle.dumps(tree)), Map.copy])
def test_trees_can_be_copied(clone):
    """Copies have the same data and marks, and marks of their own."""
    tree = parse(CONFIG, "c.yaml")
    other = clone(tree)
    assert type(other) is Map and other == tree and other.mark == tree.mark
    assert other.key_marks == tree.key_marks and other.value_marks == tree.value_marks
    assert type(other["metrics"]) is Items and other["metrics"].value_marks == tree["metrics"].value_marks
    other.put("new", 1, other.mark, other.mark)
    assert "new" not in tree.key_marks and "new" not in tree.value_marks and "new" not in tree
    assert copy.copy(tree["metrics"]).value_marks == tree["metrics"].value_marks


@pytest.mark.parametrize(
    ("text", "line", "column", "path", "piece"),
    [
        ("a: 1\nb: [1, 2\nc: 3\n", 3, 2, "", "while parsing a flow sequence that starts on line 2"),
        ("a: 'x", 1, 6, "", "quoted scalar"),
        ("a: %", 1, 4, "", "cannot start any token"),
        ("a:\n\t- b", 2, 1, "", "cannot start any token"),
        ('a: "\\UFFFFFFFF"', 1, 7, "", "not a valid escape"),
        ('a: "\\U00110000"', 1, 7, "", "not a valid escape"),
        ('a: "\\ud800"', 1, 4, "a", "surrogate"),
        ("%YAML 2.0\n---\na", 1, 1, "", "incompatible"),
        ("a: 1\nb: {c: 2, c: 3}", 2, 11, "b.c", "given twice; first on line 2, column 5"),
        ("- x: 1\n- 5: 1\n  0: 2\n  '5': 3", 4, 3, "1.5", "given twice; first on line 2, column 3"),
        ("a: !!python/object/apply:os.system [ls]", 1, 4, "a", "(!!python/object/apply:os.system)"),
        ("a:\n- !foo x", 2, 3, "a.0", "tags are not allowed (!foo)"),
        ("!foo a: 1", 1, 1, "", "tags are not allowed (!foo)"),
        ("! a", 1, 1, "", "tags are not allowed (!)"),
        ("!!map [1]", 1, 1, "", "tags are not allowed (!!map)"),
        ("!!set {a}", 1, 1, "", "tags are not allowed (!!set)"),
        ("!!binary aGk=", 1, 1, "", "tags are not allowed (!!binary)"),
        ("%TAG !e! tag:e.org,2000:\n---\na: !e!x 1", 3, 4, "a", "tags are not allowed (tag:e.org,2000:x)"),
        ("a: !!int abc", 1, 4, "a", "'abc' is not of type !!int"),
        ("a: !!bool 1", 1, 4, "a", "'1' is not of type !!bool"),
        ("a: !!float x", 1, 4, "a", "'x' is not of type !!float"),
        ("a: !!float 0x" + "f" * 500, 1, 4, "a", "too large"),
        ("a: " + "9" * 1001, 1, 4, "a", "at most 1000 digits"),
        ("a: &x\n  b: *x", 2, 6, "a.b", "alias *x refers to a collection that it stands in"),
        ("&x [[*x]]", 1, 6, "0.0", "alias *x refers to a collection that it stands in"),
        ("a: *x", 1, 4, "a", "alias *x has no anchor before it"),
        ("a: 1\n? [b]\n: 2", 2, 3, "", "a key must be a scalar"),
        ("a: {{b: 1}: 2}", 1, 5, "a", "a key must be a scalar"),
        ("a: &x [1]\n*x : 2", 2, 1, "", "a key must be a scalar"),
        ("a: 1\n---\nb: 2", 2, 1, "", "a second document starts here"),
        ("a: 1\n...\n---\nb: 2", 3, 1, "", "a second document starts here"),
        ("", 1, 1, "", "the file is empty"),
        ("# nothing\n\n", 1, 1, "", "the file is empty"),
        ("---\n", 1, 1, "", "the file is empty"),
        ("--- # nothing\n...\n", 1, 1, "", "the file is empty"),
        ("a: 1\nb: x\x07y", 2, 5, "", "control character U+0007"),
        ("a: 1\n\0", 2, 1, "", "control character U+0000"),
        ("[" * 51 + "]" * 51, 1, 51, "", "nested deeper than 50"),
        ("a: &a " + "[" * 30 + "]" * 30 + "\nb: " + "[" * 20 + "*a" + "]" * 20, 2, 24, "", "nested deeper than 50"),
    ],
)
def test_one_problem_with_its_place(text, line, column, path, piece):
    """Whatever is wrong is a ConfigError that points at it."""
    [(*place, where, message)] = problems(text)
    assert (*place, where) == (line, column, path)
    assert piece in message


def test_several_problems_at_once():
    """What does not end the reading is gathered, sorted by place, up to a syntax error."""
    text = "a: !x 1\na: 2\nb: [!y 1, *z]\nb:\n  c: 1\n  c: 2\n"
    expected = [(1, 4, "a"), (2, 1, "a"), (3, 5, "b.0"), (3, 11, "b.1"), (4, 1, "b"), (6, 3, "c")]
    assert [problem[:3] for problem in problems(text)] == expected
    assert [problem[:2] for problem in problems("a: !x 1\nb: [")] == [(1, 4), (2, 5)]
    assert [problem[:2] for problem in problems("a: !x 1\n--- b")] == [(1, 4), (2, 1)]


def test_deepest_allowed_nesting():
    """Fifty levels are read, merged, written and copied."""
    tree = parse("[" * 50 + "]" * 50, "f")
    assert parse(dump(tree), "g") == tree
    assert plain(tree) == copy.deepcopy(tree)


@pytest.mark.parametrize(
    "text",
    [
        *("[" * 100_000, "{a: " * 100_000, "- " * 100_000, "? " * 100_000, "[\n" * 100_000, "{" * 100_000),
        "a: &l0 [x, x]\n" + "".join(f"b{i}: &l{i} [*l{i - 1}, *l{i - 1}]\n" for i in range(1, 40)),
        "a: &l0 [[[[[[[[[[]]]]]]]]]]\n" + "".join(f"b{i}: &l{i} [[[[*l{i - 1}]]]]\n" for i in range(1, 2000)),
        "- &a {" + ", ".join(f"k{i}: 1" for i in range(1000)) + "}\n" + "- *a\n" * 60,
    ],
)
def test_bombs_fail_fast(text):
    """Deep nesting and multiplying aliases end early, without a deep stack (a bomb that goes off hangs here)."""
    assert len(problems(text)) == 1


def test_alias_bomb_is_located():
    """The alias that crosses the limit is the one named."""
    text = "- &a [" + ", ".join("1" * 999) + "]\n" + "- *a\n" * 120
    [(line, column, _, message)] = problems(text)
    assert (line, column) == (100, 3)
    assert "more than 100000 values" in message


@given(st.text(st.sampled_from("ab1 \n\t:-?[]{},&*!|>'\"%@#\\xuU0~."), max_size=40))
@settings(max_examples=300)
def test_any_text_gives_a_tree_or_the_one_error(text):
    """No other exception leaves the reader, and what it reads can be written."""
    try:
        tree = parse(text, "f")
    except ConfigError as error:
        assert all(problem.line >= 1 and problem.column >= 1 for problem in error.problems)
    else:
        again = parse(dump(plain(tree)), "g")
        assert again == plain(tree)


def test_load(tmp_path, monkeypatch):
    """Errors show the path as given."""
    (tmp_path / "fig7.yaml").write_bytes(b"\xef\xbb\xbfa: 1\r\n")
    (tmp_path / "table1.yaml").write_text("a: [")
    (tmp_path / "latin.yaml").write_bytes(b"a: \xfc")
    (tmp_path / "none").mkdir()
    monkeypatch.chdir(tmp_path)
    tree = load("./fig7.yaml")
    assert tree == {"a": 1} and tree.mark == ("./fig7.yaml", 1, 1) and tree.value_marks["a"].column == 4
    for path, message in [
        ("./fig8.yaml", "./fig8.yaml:1:1: there is no such file; did you mean 'fig7.yaml'?"),
        ("none/x.yaml", "none/x.yaml:1:1: there is no such file"),
        ("absent/x.yaml", "absent/x.yaml:1:1: there is no such file"),
        ("none", "none:1:1: is a directory, not a YAML file"),
        ("latin.yaml", "latin.yaml:1:1: is not UTF-8 text (byte 0xfc at offset 3)"),
        ("fig7.yaml/x", "fig7.yaml/x:1:1: cannot be read: Not a directory"),
    ]:
        with pytest.raises(ConfigError) as caught:
            load(path)
        assert str(caught.value) == message
    with pytest.raises(ConfigError, match="^table1.yaml:1:5: while parsing a flow"):
        load("table1.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load("a\0b")


def test_unreadable_file(tmp_path, monkeypatch):
    """A refusal of the system is passed on in its words."""

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("rmpc_bench.config_file.yaml.content_of", refuse)
    with pytest.raises(ConfigError, match=r"x\.yaml:1:1: cannot be read: Permission denied"):
        load(tmp_path / "x.yaml")


def test_merge():
    """Same or no kind mixes deep, another kind replaces whole; marks follow the values."""
    base = parse("controller: {kind: mpc, Hp: 10, limits: {u: [1, 2], y: 3}}\nx: {a: 1}\nkeep: {b: 1}\n", "base")
    over = parse("\ncontroller: {Hp: 20, limits: {u: 5}}\nx: none\nnew: 1\n", "over")
    before = copy.deepcopy(base), copy.deepcopy(over)
    tree = merge(base, over)
    assert (base, over) == before and base.value_marks == before[0].value_marks
    assert type(tree) is Map and list(tree) == ["controller", "x", "keep", "new"]
    assert tree["controller"] == {"kind": "mpc", "Hp": 20, "limits": {"u": 5, "y": 3}}
    assert tree["x"] == "none"
    assert locate(tree, ["controller", "Hp"]) == ("over", 2, 18)
    assert locate_key(tree, ["controller", "Hp"]) == ("over", 2, 14)
    assert locate(tree, ["controller", "kind"]) == ("base", 1, 20)
    assert locate(tree, ["controller", "limits", "y"]).file == "base"
    assert locate(tree, ["controller"]).file == tree["controller"].mark.file == "over"
    assert locate(tree, ["keep", "b"]).file == "base"
    same = merge(base, parse("controller: {kind: mpc, Hu: 3}", "over"))
    assert same["controller"]["Hp"] == 10 and same["controller"]["Hu"] == 3
    other = merge(base, parse("controller: {kind: gpc, Np: 4}", "over"))
    assert other["controller"] == {"kind": "gpc", "Np": 4}
    assert merge(parse("{kind: a, x: 1}", "b"), parse("{kind: b}", "o")) == {"kind": "b"}
    assert merge(parse("{x: 1}", "b"), parse("{kind: b}", "o")) == {"x": 1, "kind": "b"}


def test_locate():
    """Values, keys, list entries, and the deepest existing thing."""
    tree = parse(CONFIG, "c")
    assert locate(tree, []) == locate_key(tree, []) == locate(tree, ["absent", "x"]) == ("c", 1, 1)
    assert locate(tree, ["methods", "R.1", "estimator", "c"]) == ("c", 7, 41)
    assert locate_key(tree, ["methods", "R.1", "estimator", "c"]) == ("c", 7, 38)
    assert locate(tree, ["methods", "R.1", "estimator", "d", "e"]) == ("c", 7, 16)
    assert locate_key(tree, ["methods", "R.1", "estimator", "d"]) == ("c", 7, 16)
    assert locate(tree, ["version", "x"]) == ("c", 1, 10)
    assert locate(tree, ["metrics", 1]) == locate(tree, ["metrics", "1"]) == ("c", 8, 16)
    assert locate(tree, ["metrics", 2]) == locate(tree, ["metrics", -1]) == ("c", 8, 10)
    assert locate_key(tree, ["claims", 1, "says"]) == ("c", 11, 5)


def test_assign():
    """A new tree has the value and its place; the old one is untouched."""
    tree = parse(CONFIG, "c")
    before = copy.deepcopy(tree)
    mark = Mark("-s", 1, 3)
    new = assign(tree, 'methods."R.1".estimator.c', 0.5, mark)
    assert new["methods"]["R.1"]["estimator"] == {"kind": "robust-kalman", "c": 0.5}
    assert locate(new, ["methods", "R.1", "estimator", "c"]) == mark
    assert locate(new, ["methods", "R.1", "estimator", "kind"]).file == "c"
    assert locate_key(new, ["methods", "R.1"]).file == "c"
    made = assign(tree, "methods.a b=$c.estimator.kind", "x", mark)
    assert type(made["methods"]["a b=$c"]) is Map and made["methods"]["a b=$c"] == {"estimator": {"kind": "x"}}
    assert locate_key(made, ["methods", "a b=$c"]) == made["methods"]["a b=$c"].mark == mark
    listed = assign(assign(tree, "metrics.1", "iae", mark), "claims.0.says", "new", mark)
    assert listed["metrics"] == ["mse", "iae"] and listed["metrics"].value_marks[1] == mark
    assert plain(listed["claims"]) == [{"says": "new"}, {"says": "second"}]
    assert tree == before and tree["metrics"].value_marks == before["metrics"].value_marks


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("version.x", "-s:1:3: version: is 1; version.x can be set only if this is a mapping or a list"),
        ("metrics.2", "-s:1:3: metrics.2: no such entry in a list of 2 (they count from 0)"),
        ("metrics.-1", "-s:1:3: metrics.-1: no such entry in a list of 2 (they count from 0)"),
        ("metrics.x", "-s:1:3: metrics.x: no such entry in a list of 2 (they count from 0)"),
        *(
            (path, f"-s:1:3: {path!r} is not a path")
            for path in ("", ".", "a.", ".a", "a..b", '"a', '"a"b', "a." * 50 + "a")
        ),
    ],
)
def test_assign_errors(path, message):
    """Steps into scalars, entries that do not exist, and texts that are no paths."""
    with pytest.raises(ConfigError) as caught:
        assign(parse(CONFIG, "c"), path, 1, Mark("-s", 1, 3))
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("text", "path", "value", "column"),
    [
        ("runs=20", "runs", 20, 6),
        ("a.b = 1e-3", "a.b", 1e-3, 6),
        ("a=", "a", None, 3),
        ("a= ", "a", None, 3),
        ("a=b=c", "a", "b=c", 3),
        ("a=[1, {b: yes}]", "a", [1, {"b": "yes"}], 3),
        ("e=+-10%", "e", "+-10%", 3),
        ('a."b.c"="1"', 'a."b.c"', "1", 9),
    ],
)
def test_parse_override(text, path, value, column):
    """PATH, VALUE with the scalars of a document, and the place of VALUE."""
    assert parse_override(text) == (path, value, ("-s " + text, 1, column))


@pytest.mark.parametrize(
    ("text", "column", "piece"),
    [
        ("runs", 1, "expected PATH=VALUE"),
        ("=3", 1, "is not a path"),
        ("a..b=3", 1, "is not a path"),
        ("a=[1", 5, "while parsing a flow sequence"),
        ("a={b: 1, b: 2}", 10, "given twice; first on line 1, column 4"),
        ("a=!x 1", 3, "tags are not allowed (!x)"),
    ],
)
def test_parse_override_errors(text, column, piece):
    """Columns count within what the user typed."""
    with pytest.raises(ConfigError) as caught:
        parse_override(text)
    assert str(caught.value).startswith(f"-s {text}:1:{column}: ")
    assert piece in str(caught.value)


def test_stock_loaders_are_untouched():
    """Nothing is registered with PyYAML."""
    import yaml

    assert yaml.safe_load("a: yes") == {"a": True}
    assert scalar("yes") == "yes"


def test_import_is_light():
    """Nothing heavier than what the types need is imported."""
    code = "import sys, rmpc_bench.config_file.yaml as y; sys.exit(any(m in sys.modules for m in ('scipy', 'pandas')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# The reader refuses the others in a key.
CHARACTERS = st.characters(exclude_categories=("Cc", "Cf", "Cs", "Zl", "Zp"))
SCALARS = st.one_of(
    *(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(CHARACTERS, max_size=8)),
    st.text(st.sampled_from(" -+.:#,[]{}&*!|>'\"%@`~=<?0123456789eExobnulytr_\\"), max_size=6),
    st.sampled_from("1e-3 yes null 2*pi +-10% ~ <<  = - --- ... a:b 1:30 2018-04-18 0x1F 1_0 .inf on".split(" ")),
)
DATA = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(CHARACTERS, max_size=4) | SCALARS.map(str), inner, max_size=4)
    ),
    max_leaves=20,
)


def exactly(value):
    """Make types, signs of zero and the order of keys part of the comparison."""
    if isinstance(value, dict):
        return [(key, exactly(item)) for key, item in value.items()]
    return [exactly(item) for item in value] if isinstance(value, list) else (type(value), repr(value))


@given(DATA)
def test_round_trip(value):
    """What is written is read back, with types and order."""
    assert exactly(plain(parse(dump(value), "f"))) == exactly(value)


@pytest.mark.parametrize(
    "value",
    [
        *("x" * 5000, {"k" * 5000: 1}, {"k " * 600: {"a": {"b": {"c": [1]}}}}, [{"k" * 1001: ["y" * 200]}]),
        *([[[[1], [2]], [[3]]]], [["z" * 200], {"a": ["z" * 200]}], {"a": {}, "b": [], "c": ""}, {}, [], None, ""),
        *(
            "\ufeff",
            "\u2028",
            "a\nb",
            "\t",
            "😀: 😀",
            "ü",
            "a ",
            " a",
            "a #b",
            math.inf,
            -math.inf,
            -0.0,
            1e16,
            5e-324,
        ),
    ],
)
def test_round_trip_of_odd_shapes(value):
    """Long keys, lists in lists, empty things, unprintable characters."""
    assert exactly(plain(parse(dump(value), "f"))) == exactly(value)


def test_dump_by_hand():
    """Blocks outside, one line for what is simple; quotes where something else could be meant."""
    value = {
        **{"name": "fig 7", "c": 1e-05, "none": None, "yes": "1e-3", "law": "+-10%", "half": "10%"},
        "controller": {"kind": "mpc", "limits": {"u": [-220, 220.0]}, "y": "2*pi"},
        "methods": {"A": {"estimator": {"kind": "kalman", "x": {"y": 1}}}},
        "claims": [{"says": "a: b", "at": {"x": {"y": {"z": 1}}}}],
    }
    assert dump(value) == (
        'name: fig 7\nc: 1e-05\nnone: null\n"yes": "1e-3"\nlaw: "+-10%"\nhalf: "10%"\n'
        "controller:\n  kind: mpc\n  limits: {u: [-220, 220.0]}\n  y: 2*pi\n"
        "methods:\n  A:\n    estimator: {kind: kalman, x: {y: 1}}\n"
        'claims:\n  - says: "a: b"\n    at:\n      x: {y: {z: 1}}\n'
    )
    assert math.isnan(parse(dump(math.nan), "f"))
    assert dump((1, "a")) == "[1, a]\n"


@pytest.mark.parametrize(
    ("value", "error"),
    [({1: 2}, TypeError), (object(), TypeError), (["\ud800"], ValueError), (10**1001, ValueError)],
)
def test_dump_refuses(value, error):
    """What could not be read back is not written."""
    with pytest.raises(error):
        dump(value)


def test_dump_refuses_what_never_ends():
    """Too deep, or standing in itself."""
    value = []
    value.append(value)
    with pytest.raises(ValueError, match="nested deeper"):
        dump(value)


def test_other_readers_agree_on_quotes():
    """PyYAML's loader of YAML 1.1 reads the texts we write unquoted as texts, too."""

    texts = ["yes", "on", "1_000", "12:30", "2018-04-18", "0b1", "=", "<<", "~", "1e-3", "+-10%", "2*pi", "a b"]
    assert yaml.safe_load(dump(texts)) == texts
