"""The part of a file on which a name depends: what it names counts, directly or not, and nothing else."""

import ast

import pytest

from rmpc_bench.components.source import reached_text

FILE = '''
"""Docstring."""
from __future__ import annotations
import numpy as np
import helper
from other import width
depends_on = ["table.csv"]
G = 9.81
SCALE: float = 2.0
K = 0.5
TABLE = {"rhs": 1}
print("loaded", SCALE)

def slope(x):
    return G * np.sqrt(x)

def rhs(x, u, p):
    return [slope(x[0])]

class Filter:
    gain = K * width
    def update(self, y):
        return helper.use(self.gain)
'''


def part(name, text=FILE):
    return reached_text(text.encode(), [name]).decode()


def same(one, other):
    """Whether two texts are the same code."""
    return ast.dump(ast.parse(one)) == ast.dump(ast.parse(other))


def test_of_a_function_what_it_uses_is_kept():
    found = part("rhs")
    for kept in ("import numpy as np", "G = 9.81", "def slope", "def rhs", "depends_on", "print(", "SCALE"):
        assert kept in found
    for left_out in ("class Filter", "K = 0.5", "import helper", "other", "TABLE", "Docstring"):
        assert left_out not in found


def test_of_a_class_its_body_counts():
    found = part("Filter.update")
    assert all(kept in found for kept in ("K = 0.5", "import helper", "from other import width", "class Filter"))
    assert "slope" not in found


def test_a_name_that_is_looked_up_by_its_text_counts():
    text = "def a():\n    return 1\ndef b():\n    return getattr(module, 'a')()\n"
    assert same(part("b", text), text)


@pytest.mark.parametrize(
    "text",
    [
        "from other import *\ndef rhs():\n    return 1\nK = 2\n",
        "def rhs():\n    return globals()['K']\nK = 2\n",
        "def rhs():\n    return eval('K')\nK = 2\n",
        "def other():\n    return 1\n",
        "def rhs(:\n",
    ],
)
def test_where_the_tree_does_not_show_it_the_whole_file_counts(text):
    assert part("rhs", text) == text


def test_an_effect_at_import_counts():
    text = "K = 2\ndef rhs():\n    return 1\nif K > 1:\n    rhs.scale = K\n"
    assert same(part("rhs", text), text)
