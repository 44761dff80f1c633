"""claims.json follows its published schema, and holds nothing of the machine."""

import json
from pathlib import Path
from typing import get_args

import pytest
from pydantic import TypeAdapter, ValidationError
from small_experiment import cli, write

import rmpc_bench
from rmpc_bench.claims import record
from rmpc_bench.claims.claim import FINDINGS, IDENTIFIERS

SCHEMA = Path(record.__file__).with_name("claims.schema.json")
MEAN = "mean(mse[R-MPC])"
CLAIMS = [
    f"{{says: a, id: a, quote: q, source: Fig. 1, check: '{MEAN} < 0.9 * mean(mse[S-MPC])', finding: confirmed}}",
    f"{{says: b, source: additional result, check: ['{MEAN} ~ 1 +- 5%', 'max(mse[S-MPC]) < inf'], assumptions: [c]}}",
    "{says: c, source: suspected misprint, stated: {of: 'last(trace(P[S-MPC]))', value: '3.20'}}",
    f"{{says: d, holds_for: any, check: ['{MEAN} < 1e9', 'slope(trace(P[R-MPC])) < 0']}}",
    f"{{says: e, check: '1 < 2', stated: {{of: '{MEAN}', value: 1, tolerance: 0.5, text: one}}}}",
    "{says: f, stated: much}",
]


def names_of(node):
    """Every key of a tree of JSON."""
    if isinstance(node, dict):
        return set(node).union(*map(names_of, node.values()))
    return set().union(*map(names_of, node)) if isinstance(node, list) else set()


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return claims.json of a run with every kind of claim, by a run and by a later report."""
    here = tmp_path_factory.mktemp("record")
    path = write(here, name="fig7", paper="zenere2018", runs=12, claims=f"[{', '.join(CLAIMS)}]")
    assert cli("run", path, "-o", here / "out", "-j", 1, "--progress", "none").exit_code == 0
    first = (here / "out" / "claims.json").read_bytes()
    rmpc_bench.publish(rmpc_bench.load_results(here / "out"), to=here / "again")
    return first, (here / "again" / "claims.json").read_bytes()


def test_the_published_schema_is_that_of_the_code():
    """Made by ``record.json_schema()``; every word for a finding is in it."""
    made = record.json_schema()
    assert json.loads(SCHEMA.read_text(encoding="utf-8")) == made, "write json_schema() to claims.schema.json again"
    assert set(get_args(record.Word)) == set(FINDINGS)
    assert {"identifier", "hash", "numerics", "command"} <= set(made["$defs"]["ExperimentRecord"]["required"])


def test_claims_json_follows_the_schema(written):
    """Every key is there and none besides; strict JSON."""
    data = json.loads(written[0], parse_constant=pytest.fail)
    TypeAdapter(record.ClaimsRecord).validate_python(data)
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))

    def check(node, rule):
        rule = schema["$defs"][rule["$ref"].rsplit("/", 1)[1]] if "$ref" in rule else rule
        if rule.get("type") == "object" and "properties" in rule:
            assert set(node) == set(rule["required"]) == set(rule["properties"])
            for name, inner in rule["properties"].items():
                check(node[name], inner)
        elif rule.get("type") == "array" and isinstance(node, list) and "items" in rule:
            for item in node:
                check(item, rule["items"])
        elif "anyOf" in rule and isinstance(node, dict):
            check(node, next(option for option in rule["anyOf"] if "$ref" in option or option.get("type") == "object"))

    check(data, schema)
    with pytest.raises(ValidationError):
        TypeAdapter(record.ClaimsRecord).validate_python({**data, "claims": [{"finding": "wrong"}]})


def test_what_is_recorded(written):
    """The experiment by its hash and the command, each claim by its kind, numbers and findings."""
    data = json.loads(written[0])
    experiment = data["experiment"]
    assert experiment["identifier"] == IDENTIFIERS["zenere2018"] == "arXiv:1804.06746"
    assert experiment["command"] == "rmpc-bench run configs/zenere2018/fig7.yaml"
    assert (experiment["version"], experiment["numerics"]) == (rmpc_bench.__version__, rmpc_bench.NUMERICS)
    assert (experiment["runs"], experiment["seed"], experiment["final"]) == (12, 7, True)
    claims = data["claims"]
    assert [claim["kind"] for claim in claims[:3]] == [
        "statement of the paper",
        "additional result",
        "suspected misprint",
    ]
    assert claims[0]["numbers"][0]["change"]["of"] == "factor"
    assert claims[2]["finding"] in ("equal", "close", "different") and claims[2]["sizes"][0]["stated"] == "3.20"
    # Two cases share 2.5 %, each of them one-sided.
    assert claims[3]["confidence"] == pytest.approx(1 - 2 * 0.025 / 2)
    assert claims[5]["finding"] == "not-testable" and claims[5]["stated"] == "much"


def test_nothing_depends_on_the_machine(written):
    """`report` of a copied directory writes the same bytes; no paths, platforms or versions of libraries."""
    assert written[0] == written[1]
    assert not names_of(json.loads(written[0])) & {"versions", "platform", "blas", "git", "path", "directory"}
