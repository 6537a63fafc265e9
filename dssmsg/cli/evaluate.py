"""`dssmsg eval`: quality in numbers, from scripts that anyone can run."""

from __future__ import annotations

import enum
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssmsg.cli import evaluate_diagnosis, evaluate_navigation, evaluate_table4, evaluate_tables
from dssmsg.cli.options import ConfigOption, JsonOption, ScenesOption, SetOption
from dssmsg.errors import StorageError

if TYPE_CHECKING:
    from dssmsg.interfaces import Encoder, Llm


class Assets(enum.StrEnum):
    """Which furniture the rooms are furnished with."""

    REAL = "real"
    EMBEDDED = "embedded"


def register(app: typer.Typer) -> None:
    """Add the command group to the program."""
    group = typer.Typer(help="Measure quality against the truth.", rich_markup_mode=None)
    app.add_typer(group, name="eval")
    evaluate_tables.register(group)
    evaluate_navigation.register(group)
    evaluate_table4.register(group)
    evaluate_diagnosis.register(group)

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

        \b
        Examples:
          dssmsg eval perception
          dssmsg eval perception --rooms 2 --views 8 --json
        """
        show_perception(rooms, views, assets.value, weights, as_json=as_json)

    @group.command()
    def text(
        config: ConfigOption = None,
        as_json: JsonOption = False,
    ) -> None:
        """Sentences that name a need: is the right label first?

        The configured encoder alone, after the configured language model, and with the table of purposes.
        The set `fresh` was written after that table.

        \b
        Example:
          dssmsg eval text --json
        """
        show_text(config, as_json=as_json)

    @group.command()
    def static(
        scenes: ScenesOption = "rs_int,ihlen_1_int",
        perception: Annotated[
            str, typer.Option(metavar="A,B", help="Perception plug-ins, by name.")
        ] = "furniture,oracle",
        seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each, with seeds from 0.")] = 5,
        config: ConfigOption = None,
        sets: SetOption = None,
        work: Annotated[
            Path | None,
            typer.Option(
                metavar="FOLDER", help="Keep recordings and results here, and go on where it stopped."
            ),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Whole missions: static objects of the map against the truth, mean and spread over seeds.

        Precision, recall and F1 by label and place. Without --work nothing is kept.

        \b
        Examples:
          dssmsg eval static --seeds 2 --work runs
          dssmsg eval static --scenes rs_int --perception oracle --json
        """
        show_static(
            names_of(scenes, "--scenes"),
            names_of(perception, "--perception"),
            seeds,
            config,
            sets or (),
            work,
            as_json=as_json,
        )


def show_static(
    scenes: Sequence[str],
    perceptions: Sequence[str],
    seeds: int,
    config: Path | None,
    sets: Sequence[str],
    work: Path | None,
    *,
    as_json: bool,
) -> None:
    """Print the rows of `evaluate_static`; progress goes to stderr."""
    from dssmsg.cli.output import stdout_to_stderr

    with stdout_to_stderr(), work_folder(work) as folder:
        from dssmsg.evaluate.static_runs import evaluate_static, static_rows

        runs = evaluate_static(
            folder, scenes=scenes, perceptions=perceptions, seeds=range(seeds), config=config, sets=sets,
            progress=_progress,
        )  # fmt: skip
    print_rows(static_rows(runs), as_json=as_json)


@contextmanager
def work_folder(work: Path | None) -> Iterator[Path]:
    """The folder that is asked for, made where it is missing; else one that goes afterwards.

    Raises StorageError where it cannot be made.
    """
    if work is None:
        with tempfile.TemporaryDirectory(prefix="dssmsg-eval-") as place:
            yield Path(place)
        return
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be made: {error.strerror or error}", file=work) from error
    yield work


def names_of(text: str, option: str) -> list[str]:
    """The names of a list with commas, each once."""
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise typer.BadParameter(
            f"expected names with commas between, each once, got '{text}'", param_hint=option
        )
    return names


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
    """Print the rows of all sets of sentences, and on stderr the sentences that went wrong."""
    from dssmsg.cli.output import note, stdout_to_stderr

    rows: list[dict[str, Any]] = []
    with stdout_to_stderr():
        from dssmsg.evaluate.text import SETS, answer_sentences, methods, text_rows

        compared = methods(*_language(config))
        for which in SETS:
            for method, scores in compared.items():
                answers = answer_sentences(scores, which)
                rows += text_rows(answers, which, method)
                for answer in answers:
                    if answer.rank:
                        note(f"{method}: {answer.text}: {answer.said}, not {' or '.join(answer.right)}")
    print_rows(rows, as_json=as_json)


def _language(path: Path | None) -> tuple[Encoder, str, Llm, str]:
    """The configured encoder and language model, each with its name."""
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
    encoder, llm = built
    return encoder.plugin, encoder.registration.name, llm.plugin, llm.registration.name


def print_rows(rows: Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    """Rows of an evaluation as JSON, or as a table for a reader."""
    from dssmsg.cli.output import print_json

    if as_json:
        print_json(list(rows))
        return
    columns = ("scene", "method", "perception", "metric", "mean", "std", "n")
    cells = [columns, *(tuple(_cell(row[name]) for name in columns) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def _cell(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else "-" if value is None else str(value)


def _progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
