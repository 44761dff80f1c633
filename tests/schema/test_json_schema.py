"""The JSON Schema of a configuration accepts every configuration that stands, and refuses what an editor can see."""

from pathlib import Path

import pytest
from jsonschema import Draft7Validator

from rmpc_bench.config_file.tree import DELETE, plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.schema.json_schema import json_schema

CONFIGS = sorted(Path(__file__).parents[2].joinpath("configs").rglob("*.yaml"))


@pytest.fixture(scope="module")
def schema():
    return json_schema()


@pytest.fixture(scope="module")
def quickstart():
    return plain(load(next(path for path in CONFIGS if path.stem == "quickstart")))


def test_it_is_a_valid_schema(schema):
    Draft7Validator.check_schema(schema)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_configuration_follows_it(schema, path):
    errors = [error.message for error in Draft7Validator(schema).iter_errors(without_deleted(plain(load(path))))]
    assert not errors


def without_deleted(tree):
    """Leave out the keys with the tag `!delete`, which has no value that a schema could describe."""
    if not isinstance(tree, dict):
        return tree
    return {key: without_deleted(value) for key, value in tree.items() if value is not DELETE}


@pytest.mark.parametrize(
    "change",
    [
        {"sed": 1},
        {"runs": 0},
        {"seed": -1},
        {"version": 2},
        {"metrics": ["msee"]},
        {"time": {"step": 0.1, "duraton": 20}},
        {"plant": {"kind": "sevro"}},
        {"noise": {"process": "some"}},
        {"methods": {"A": {"estimater": {"kind": "kalman"}}}},
        {"methods": {"A": {"estimator": {"kind": "robust-kalman", "c": -1}}}},
        {"claims": [{"check": "mse[A] < 1"}]},
    ],
    ids=lambda change: "-".join(change),
)
def test_a_mistake_is_refused(schema, quickstart, change):
    assert not Draft7Validator(schema).is_valid({**quickstart, **change})


def test_a_quantity_is_accepted_where_a_number_stands(schema, quickstart):
    given = {**quickstart, "statistics": {"confidence": "95%"}, "time": {"step": "1/10", "duration": 20}}
    assert Draft7Validator(schema).is_valid(given)


def test_keys_have_description_and_default(schema):
    key = schema["definitions"]["estimators.robust-kalman"]["properties"]["c"]
    assert key["description"]
    assert schema["definitions"]["controllers.mpc"]["properties"]["Hp"]["description"]
    assert all(schema["properties"][name]["description"] for name in schema["properties"])


def test_a_file_that_extends_another_needs_its_own_name_only(schema):
    validator = Draft7Validator(schema)
    own = {"extends": "fig7.yaml", "name": "more"}
    assert validator.is_valid(own)
    assert validator.is_valid({**own, "reference": {"value": 1}, "methods": {"A": {"estimator": {"c": 0.1}}}})
    assert not validator.is_valid({"extends": "fig7.yaml"})
    assert not validator.is_valid({**own, "runs": 0})
    assert not validator.is_valid({"name": "more", "reference": {"value": 1}})
