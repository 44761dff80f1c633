"""rmpc-bench schema."""

from __future__ import annotations

import json

import click

from rmpc_bench.cli import exits


@click.command()
@exits.guarded
def schema() -> int:
    """Print the JSON Schema of a configuration.

    An editor with a YAML language server then completes and checks keys.  Write the schema to a file and name it in the
    first line of a configuration: # yaml-language-server: $schema=rmpc-bench.schema.json
    """
    from rmpc_bench.schema.json_schema import json_schema

    click.echo(json.dumps(json_schema(), indent=2))
    return 0
