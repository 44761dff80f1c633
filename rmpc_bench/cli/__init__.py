"""The command line.  The module of a verb is imported when the verb is called, so that `--help` is fast."""

from __future__ import annotations

import atexit
import dataclasses
import gc
import sys
from functools import cache
from importlib import import_module
from typing import Any

import click

from rmpc_bench import __version__
from rmpc_bench.cli.exits import CANNOT_WRITE
from rmpc_bench.cli.streams import usable_streams

_VERBS: dict[str, tuple[str, str]] = {
    "init": ("rmpc_bench.cli.init:init", "Write an experiment with components of your own to start from."),
    "run": ("rmpc_bench.cli.run:run", "Run an experiment, or continue it, and write its results."),
    "import": ("rmpc_bench.cli.import_table:import_", "Compare runs of your own simulator, from a table of them."),
    "suite": ("rmpc_bench.cli.suite:suite", "Compare methods on the sets of published systems in configs/suite."),
    "check": ("rmpc_bench.cli.check:check", "Validate configurations and show what they compare."),
    "list": ("rmpc_bench.cli.catalogue:list_", "List the names a configuration may use."),
    "describe": ("rmpc_bench.cli.describe:describe", "Show a component or a configured system, and its keys."),
    "status": ("rmpc_bench.cli.results:status", "Show how far an experiment and its shards are."),
    "merge": ("rmpc_bench.cli.results:merge", "Join the shards of a directory and write its results."),
    "show": ("rmpc_bench.cli.show:show", "Replay one run bit for bit, with its full trace."),
    "report": ("rmpc_bench.cli.results:report", "Write tables and figures again from stored trials."),
    "compare": ("rmpc_bench.cli.results:compare", "Compare the results of two directories, run by run."),
    "pack": ("rmpc_bench.cli.archive:pack", "Pack results into one file that others can check."),
    "verify": ("rmpc_bench.cli.archive:verify", "Compute packed results again and compare them."),
    "schema": ("rmpc_bench.cli.catalogue:schema", "Print the JSON Schema of a configuration, for editors."),
}


def late_methods() -> None:
    """Let dataclasses of the bench compile a method such as ``__eq__`` when it is first called: 0.1 ms each.

    Python 3.13 does not have what is replaced.  Other dataclasses stay as they are: a class of a user may be sent to a
    worker by value, and a method that is not compiled yet cannot be.
    """
    usual = getattr(dataclasses, "_create_fn", None)
    if usual is None:
        return

    def create(name: str, *arguments: Any, **settings: Any) -> Any:
        module = (settings.get("globals") or {}).get("__name__", "")
        if name == "__init__" or not module.startswith("rmpc_bench."):
            return usual(name, *arguments, **settings)
        made = cache(lambda: usual(name, *arguments, **settings))

        def late(*given: Any) -> Any:
            return made()(*given)

        late.__name__ = name
        return late

    dataclasses._create_fn = create  # type: ignore[attr-defined]


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called; their help lines stand here."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the program; closed standard streams are no error."""
        usable_streams()
        thresholds, is_program = gc.get_threshold(), not args and kwargs.get("args") is None
        if is_program:
            atexit.register(gc.freeze)  # of a program that ends nothing is visited to be freed
            late_methods()
        try:
            return super().main(*args, **kwargs)
        except OSError as error:  # of --help; verbs report their own errors
            click.echo(f"output cannot be written: {error}", err=True)
            sys.exit(CANNOT_WRITE)
        finally:
            if not is_program:
                gc.set_threshold(*thresholds)
                gc.enable()

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of a day's work."""
        return list(_VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a verb."""
        if cmd_name not in _VERBS:
            return None
        module, attribute = _VERBS[cmd_name][0].split(":")
        command = getattr(import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help lines without importing the verbs."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in _VERBS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="rmpc-bench")
def main() -> None:
    """Monte Carlo bench for robust estimation and model predictive control.

    Start with: rmpc-bench run quickstart
    """
