"""`dssmsg eval`: quality in numbers, from scripts that anyone can run."""

from __future__ import annotations

import enum
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from dssmsg.interfaces import Encoder, Llm


class Assets(enum.StrEnum):
    """Which furniture the rooms are furnished with."""

    REAL = "real"
    EMBEDDED = "embedded"


JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on stdout, errors too.")]


def register(app: typer.Typer) -> None:
    """Add the command group to the program."""
    group = typer.Typer(help="Measure quality against the truth.", rich_markup_mode=None)
    app.add_typer(group, name="eval")

    @group.command()
    def perception(
        rooms: Annotated[int, typer.Option(min=1, max=20, help="Rooms of each kind.")] = 20,
        views: Annotated[int, typer.Option(min=1, max=64, help="Views of each room.")] = 16,
        assets: Annotated[Assets, typer.Option(help="Furniture of the rooms.")] = Assets.REAL,
        weights: Annotated[
            Path | None, typer.Option(metavar="FOLDER", help="Other weights than the shipped ones.")
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """The furniture recogniser in rooms it was not trained in.

        Masks, labels and objects, for models it was trained on and for held-out ones.
        """
        show_perception(rooms, views, assets.value, weights, as_json=as_json)

    @group.command()
    def text(
        config: Annotated[
            Path | None,
            typer.Option(
                "--config", metavar="FILE", help="YAML file; else ./dssmsg.yaml, else the packaged one."
            ),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Sentences that name a need: is the right label first?

        The configured encoder alone, and after the configured language model.
        """
        show_text(config, as_json=as_json)


def show_perception(rooms: int, views: int, assets: str, weights: Path | None, *, as_json: bool) -> None:
    """Print the rows of `evaluate_perception`; progress goes to stderr."""
    from dssmsg.cli.output import stdout_to_stderr

    with stdout_to_stderr():
        from dssmsg.evaluate.perception import evaluate_perception
        from dssmsg.recogniser.recogniser import Recogniser

        recogniser = Recogniser(weights)
        rows = evaluate_perception(recogniser, rooms=rooms, views=views, assets=assets, progress=_progress)
    print_rows(rows, as_json=as_json)


def show_text(config: Path | None, *, as_json: bool) -> None:
    """Print the rows of both sets of sentences, and on stderr the sentences that went wrong."""
    from dssmsg.cli.output import note, stdout_to_stderr

    rows: list[dict[str, Any]] = []
    with stdout_to_stderr():
        from dssmsg.evaluate.text import SETS, answer_sentences, text_rows

        names, encoder, llm = _language(config)
        for which in SETS:
            for method, model in ((names[0], None), (f"{names[1]} + {names[0]}", llm)):
                answers = answer_sentences(encoder, which, llm=model)
                rows += text_rows(answers, which, method)
                for answer in answers:
                    if answer.rank:
                        note(f"{method}: {answer.text}: {answer.said}, not {' or '.join(answer.right)}")
    print_rows(rows, as_json=as_json)


def _language(path: Path | None) -> tuple[tuple[str, str], Encoder, Llm]:
    """The configured encoder and language model with their names."""
    from dssmsg.config import load_config
    from dssmsg.contexts import ContextFactory
    from dssmsg.graph.ids import IdAllocator
    from dssmsg.graph.scene_graph import SceneGraph
    from dssmsg.host import Host

    config = load_config(path)
    with config.naming_files():
        host = Host.load(config.plugins, config.base_dir)
        contexts = ContextFactory(
            host, config.seed, SceneGraph(), IdAllocator(), config.base_dir, Path(), "eval"
        )
        built = [
            host.build(kind, slot, contexts, base_dir=config.base_dir, key=kind)
            for kind, slot in (("encoder", config.encoder), ("llm", config.llm))
        ]
    names = (built[0].registration.name, built[1].registration.name)
    return names, built[0].plugin, built[1].plugin


def print_rows(rows: Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    """Rows of an evaluation as JSON, or as a table for a reader."""
    from dssmsg.cli.output import print_json

    if as_json:
        print_json(list(rows))
        return
    columns = ("scene", "method", "metric", "mean", "std", "n")
    cells = [columns, *(tuple(_cell(row[name]) for name in columns) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def _cell(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
