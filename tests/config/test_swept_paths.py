"""Every path that a sweep accepts tells its points apart: two values give two keys of at least one method.

The designs of a shipped configuration are made once; a swept value makes those again that depend on it.
"""

from pathlib import Path

import pytest
from missing_libraries import skip_without_libraries

from rmpc_bench import load_config
from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.config.build import build
from rmpc_bench.config.designs import DesignCache
from rmpc_bench.config.own_code import FirstCalls, OwnCode
from rmpc_bench.config.plugins import load_plugins
from rmpc_bench.config.sweep import (
    METHOD_COMPONENTS,
    SWEPT,
    SweepReader,
    SweptTree,
    SweptValue,
    assigned,
    compose,
    expand,
)
from rmpc_bench.config.validate import validate_sections
from rmpc_bench.config_file.extends import read
from rmpc_bench.config_file.inherit import inherit
from rmpc_bench.config_file.matrix_files import with_matrices
from rmpc_bench.config_file.tree import Map
from rmpc_bench.types import ConfigError

CONFIGS = Path(__file__).parents[2] / "configs"
QUICK = ("belda2017/exp1", "belda2017/fig4", "benchmarks/f404")
"""Configurations whose designs take little time; all others are slow."""
EVERY = sorted(path.relative_to(CONFIGS).with_suffix("").as_posix() for path in CONFIGS.rglob("*.yaml"))
_WITHOUT = ("claims", "figures", "report", "tune")


class Keys:
    """Makes the designs of a configuration at the first point of its sweep, with one value replaced.

    Parameters
    ----------
    path : the file
    """

    def __init__(self, path):
        self.access = CodeAccess.of(path, [])
        tree = with_matrices(inherit(read(path, [], [])), path)
        load_plugins(tree, self.access)
        self.tree = expand(tree, [], self.access).points[0].tree.copy()
        for key in _WITHOUT:
            self.tree.pop(key, None)
        self.cache, self.calls = DesignCache(), FirstCalls()

    def of(self, tree):
        """Return the keys of the methods; None where the program refuses the values."""
        own = OwnCode(self.access)
        [draft] = validate_sections(
            [SweptTree({}, compose(tree, self.access))], runs=None, smoke=False, access=self.access
        )
        [(point, *_)] = build([draft], own, smoke=False, cache=self.cache, calls=self.calls)
        return None if point is None or draft.problems or own.problems else point.method_keys

    def with_value(self, path, value):
        """Return the same with another value of a path that may be swept; None where it may not."""
        try:
            return self.of(assigned(self.tree, [path], [SweptValue(str(value), value, self.tree.mark, self.tree.mark)]))
        except ConfigError:
            return None

    def may_be_swept(self, steps):
        return not SweepReader(self.tree, Map(mark=self.tree.mark))._refusal(steps)


def is_numeric(node):
    if isinstance(node, list):
        return bool(node) and all(map(is_numeric, node))
    return isinstance(node, float | int)


def leaves(node, steps=()):
    """Yield the paths of numbers, of vectors and of matrices in plain data, with their values."""
    if is_numeric(node):
        yield steps, node
    elif isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from leaves(value, (*steps, str(key)))


def swept_values(config):
    """Yield the paths that may be swept in a configuration with all its defaults, as steps, and their values."""
    given = config.first_point
    methods = {
        name: {key: own[key] for key in METHOD_COMPONENTS if key in own} for name, own in given["methods"].items()
    }
    yield from leaves({key: given[key] for key in SWEPT if key in given} | {"methods": methods})


def others(value):
    """Yield values close to one: the first that the program accepts is swept."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int):
        yield from (value + 1, value - 1, 2 * value)
    else:
        for scale, offset in ((1.25, 0.5), (0.8, 0), (1.01, 0), (1, 0.5), (1, 1), (1, 1e-3), (0, -0.5)):
            yield changed(value, scale, offset)


def changed(value, scale, offset):
    return [changed(each, scale, offset) for each in value] if isinstance(value, list) else scale * value + offset


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow, id=name) for name in EVERY]
)
@pytest.mark.long
def test_two_values_of_every_path_that_a_sweep_accepts_give_two_keys(name):
    """Numbers, vectors, matrices and switches of the file and of all defaults.

    Where both have one key the program refuses the sweep, as test_sweep.py shows; no path is of this kind here.
    """
    file = CONFIGS / f"{name}.yaml"
    skip_without_libraries(file)
    made = Keys(file)
    before = made.of(made.tree)
    assert before is not None
    accepted, alike, paths = 0, [], [*swept_values(load_config(file))]
    for steps, value in paths:
        path = ".".join(f'"{step}"' if "." in step else step for step in steps)
        for other in others(value) if made.may_be_swept(steps) else ():
            after = None if other == value else made.with_value(path, other)
            if after is not None:
                accepted += 1
                alike += [path] if after == before else []
                break
    assert not alike and accepted > len(paths) / 2
