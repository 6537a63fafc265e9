"""The command line. Thin: parse, call, print; every command's work is imported when it is called.

`main` is the one place where errors are handled: a DssmsgError becomes one line on stderr and its exit
code, with `--json` an object on stdout too; anything else keeps its traceback.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from dssmsg import __version__
from dssmsg.cli import (
    diff,
    episodes,
    evaluate,
    explain,
    models,
    query,
    recordings,
    replay,
    report,
    sweep,
    view,
)
from dssmsg.cli.options import ConfigOption, JsonOption

# Plain help: rich would take as long to import as everything else together.
app = typer.Typer(
    name="dssmsg",
    help="Run a robot through rooms, build a dynamic 3D scene graph, and record why it is what it is.",
    rich_markup_mode=None,
)

ConfigArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="CONFIG", help="YAML file; else ./dssmsg.yaml, else the packaged one.", show_default=False
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set one value, like perception.use=oracle; repeatable."),
]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dssmsg {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error; log more.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


@app.command()
def init(
    directory: Annotated[Path, typer.Argument(metavar="DIRECTORY", help="Where to write.")] = Path(),
) -> None:
    """Write a dssmsg.yaml and an example plug-in to start from.

    Overwrites nothing.

    \b
    Examples:
      dssmsg init
      dssmsg init my-robot
    """
    from dssmsg.cli.project import write_project

    write_project(directory)


@app.command()
def run(
    config: ConfigArgument = None,
    sets: SetOption = None,
    goal: Annotated[
        list[str] | None,
        typer.Option(
            "--goal", metavar="TEXT", help="Drive to what TEXT asks for, after the map; repeatable."
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", metavar="N", help="Seed of the run.")] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Open the recording in the viewer afterwards.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 if an episode failed or work was skipped.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Drive a mission and leave a recording; prints a summary.

    \b
    Examples:
      dssmsg run
      dssmsg run my.yaml --seed 3 --view
      dssmsg run --set perception.use=oracle --goal "a place to wash up" --json
    """
    from dssmsg.cli.run import run_command

    raise typer.Exit(
        run_command(
            config, sets or [], goals=goal or [], seed=seed, view=view, strict=strict, as_json=as_json
        )
    )


@app.command("config")
def config_command(
    config: ConfigArgument = None,
    sets: SetOption = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of the file instead.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print the resolved configuration.

    Every option of every plug-in is in it, defaults included.

    \b
    Examples:
      dssmsg config
      dssmsg config my.yaml --set association.delta_sim=1.2
      dssmsg config --schema > schema.json
    """
    from dssmsg.cli.configuration import show_config

    show_config(config, sets or [], schema=schema, as_json=as_json)


@app.command()
def plugins(
    config: ConfigOption = None,
    options: Annotated[bool, typer.Option("--options", help="Print every plug-in's options too.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the plug-ins and what failed to load.

    \b
    Examples:
      dssmsg plugins
      dssmsg plugins --config my.yaml --options --json
    """
    from dssmsg.cli.plugins import list_plugins

    list_plugins(config, options=options, as_json=as_json)


@app.command()
def doctor(
    config: ConfigOption = None,
    credits: Annotated[
        bool, typer.Option("--credits", help="Print the authors of the furniture in use.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check this machine and this configuration.

    Packages, renderer, furniture, viewer, plug-ins, model files, disk.

    \b
    Examples:
      dssmsg doctor
      dssmsg doctor --config my.yaml --json
    """
    from dssmsg.cli.doctor import show_doctor

    raise typer.Exit(show_doctor(config, credits=credits, as_json=as_json))


view.register(app)
recordings.register(app)
replay.register(app)
diff.register(app)
explain.register(app)
query.register(app)
report.register(app)
models.register(app)
episodes.register(app)
sweep.register(app)
evaluate.register(app)


_THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
"""Our matrices are small: more BLAS threads do nothing but spin on the core that the recording is written on.
Set before numpy is imported; whoever knows better sets them in the environment."""


_COMPLETE = "_DSSMSG_COMPLETE"
"""Set by the completion that `--install-completion` puts into the shell's start-up file."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    from dssmsg.cli.ending import Ending
    from dssmsg.processes import collect_seldom

    for variable, value in _THREADS.items():
        os.environ.setdefault(variable, value)
    collect_seldom()
    given = list(sys.argv[1:] if arguments is None else arguments)
    ending = Ending(as_json="--json" in given, debug="--debug" in given)
    # --debug may stand anywhere; the parser knows it in front of the command.
    rest = [one for one in given if one != "--debug"]
    return ending.of(lambda: _invoke(rest, debug=ending.debug))


def _invoke(arguments: list[str], *, debug: bool) -> int:
    command: Any = typer.main.get_command(app)
    front = ["--debug"] if debug else []
    if _COMPLETE in os.environ:  # a shell asks what could come next: the parser answers, and exits
        command.main(prog_name="dssmsg")
    try:
        # Not command.main(), which would turn Ctrl-C and SIGTERM into an exit code of its own.
        with command.make_context("dssmsg", [*front, *(arguments or ["--help"])]) as context:
            command.invoke(context)
    except typer.Exit as done:
        return done.exit_code
    return 0
