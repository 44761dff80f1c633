"""Messages about keys of components from files."""

import pytest
from small_experiment import write

from rmpc_bench.config.load import load_config
from rmpc_bench.types import ConfigError

CODE = """
from rmpc_bench import single_run

@single_run
class Typo:
    def __init__(self, modle):
        self.model = modle
    def update(self, y):
        return y
"""


def test_a_misspelt_argument_of_the_code(tmp_path):
    """It would be a key that must be given; the value that the bench gives is named."""
    (tmp_path / "own.py").write_text(CODE, encoding="utf-8")
    path = write(tmp_path, methods="{A: {estimator: {file: own.py:Typo}}}")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert "'modle' is missing; if it is an argument in your code, did you mean 'model'" in str(caught.value)
