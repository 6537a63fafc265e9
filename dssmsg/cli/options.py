"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="YAML file; else ./dssmsg.yaml, else the packaged one."),
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value; may be given often.")
]
ScenesOption = Annotated[str, typer.Option(metavar="A,B", help="Scenes, by name.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on stdout, errors too.")]
