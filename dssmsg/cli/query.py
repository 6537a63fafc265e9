"""`dssmsg query`: ground a sentence in a recorded graph, now or at a past time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssmsg.cli.options import ConfigOption, JsonOption

if TYPE_CHECKING:
    from dssmsg.config import RunConfig
    from dssmsg.interfaces import Encoder, Grounding, Llm, TargetGraph
    from dssmsg.recording.reader import Recording


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def query(
        words: Annotated[
            list[str], typer.Argument(metavar="[REC] TEXT", help="A recording, else the newest; a sentence.")
        ],
        at: Annotated[
            str | None,
            typer.Option("--at", metavar="TIME", help="frame=120, time=24.5 or update=300; else the end."),
        ] = None,
        top: Annotated[
            int, typer.Option(min=1, max=1000, help="Waypoints to print, each by its best viewpoint.")
        ] = 5,
        config: ConfigOption = None,
        sets: Annotated[
            list[str] | None,
            typer.Option("--set", metavar="KEY=VALUE", help="Set one value, like grounding.use=objects."),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Say from where in a recorded map a sentence is answered, and why.

        Encoder, language model and grounding are those of the configuration, whatever the run had.

        \b
        Examples:
          dssmsg query "a place to sit"
          dssmsg query recordings/run.rrd "the cup on the table" --json
        """
        show_query(words, at, top, config, sets or (), as_json=as_json)


def show_query(
    words: Sequence[str],
    at: str | None,
    top: int,
    config: Path | None,
    sets: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print the answer to a sentence.

    Raises InputError for the recording or a sentence that is not understood, ConfigError for the time or the
    configuration, PluginError where the language model fails.
    """
    from dssmsg.cli.output import print_json, show, stdout_to_stderr
    from dssmsg.cli.recordings import chosen, moment, warn_of_cuts

    if len(words) > 2:
        raise typer.BadParameter("expected a recording and one sentence; put the sentence in quotes")
    if not words[-1].strip() or words[-1].endswith(".rrd"):  # a recording alone: the sentence was forgotten
        raise typer.BadParameter(f"expected a sentence, got {words[-1]!r}")
    path = chosen(Path(words[0]) if len(words) == 2 else None)
    with stdout_to_stderr():
        from dssmsg import checks
        from dssmsg.config import load_config
        from dssmsg.recording.reader import Recording
        from dssmsg.review.query import query_json, query_text
        from dssmsg.target_graph import target_graph_json

        resolved = load_config(config, sets=sets)
        with Recording.open(path) as opened:
            frame, update = moment(opened, at)
            warn_of_cuts(opened)
            graph = opened.graph_at(frame, update=update)
            llm, grounding = plugins_over(resolved, opened, graph)
            target = target_of(llm, words[-1], resolved, key="TEXT")
            candidates = checks.check_candidates(graph, grounding.ground(target))
        answer = query_json(
            words[-1],
            str(path),
            {"frame": frame, "update": update},
            target_graph_json(target),
            candidates,
            graph,
        )
    if as_json:
        print_json(answer)
    else:
        show(query_text(answer, top))


def plugins_over(config: RunConfig, recording: Recording, graph: Any) -> tuple[Llm, Grounding]:
    """The language model and the grounding of a configuration, over a recorded graph."""
    from dssmsg.cli.output import note
    from dssmsg.cli.plugins import warn_of_failures
    from dssmsg.contexts import ContextFactory
    from dssmsg.graph.ids import IdAllocator
    from dssmsg.graph.read_only import ReadOnlyGraph
    from dssmsg.host import Host
    from dssmsg.interfaces import SourceInfo
    from dssmsg.review.recorded_vectors import RecordedVectors

    camera = recording.camera()
    info = None if camera is None else SourceInfo("recording", camera, drivable=False, has_truth=False)
    with config.naming_files():
        host = Host.load(config.plugins, config.base_dir)
        contexts = ContextFactory(
            host,
            config.seed,
            ReadOnlyGraph(graph),
            IdAllocator(),
            config.base_dir,
            Path(),
            "query",
            source=info,
        )

        def build(kind: str) -> Any:
            slot = getattr(config, kind)
            return host.build(kind, slot, contexts, base_dir=config.base_dir, key=kind).plugin

        encoder = _working(build, recording)
        recorded = isinstance(encoder, RecordedVectors)
        contexts.encoder = None if recorded else encoder  # made-up vectors would mislead the language model
        contexts.llm = build("llm")
        contexts.encoder = encoder
        known = recording.facts["feature_space"]
        if known is not None and known != encoder.space:
            note(f"the map's features live in {known}, the encoder's in {encoder.space}: labels are compared")
        grounding = build("grounding")
    warn_of_failures(host)
    return contexts.llm, grounding


def _working(build: Callable[[str], Any], recording: Recording) -> Encoder:
    """The configuration's encoder; where it cannot run here, the vectors that the recording holds."""
    from dssmsg.cli.output import note
    from dssmsg.errors import PluginError
    from dssmsg.lexicon.aliases import builtin_aliases
    from dssmsg.review.recorded_vectors import RecordedVectors

    try:
        encoder: Encoder = build("encoder")
        encoder.encode_labels(["thing"])  # models are loaded on first use
        return encoder
    except (ImportError, PluginError) as error:
        vectors = RecordedVectors(recording, builtin_aliases())
        note(
            f"the encoder cannot run here ({' '.join(str(error).split())}): {vectors.labels} labels have"
            " recorded vectors, other names are compared by the table of aliases"
        )
        return vectors


def target_of(llm: Llm, sentence: str, config: RunConfig, *, key: str) -> TargetGraph:
    """The target graph of a sentence that the user gave as the argument or option `key`.

    Raises InputError where it is not understood, PluginError where the language model fails.
    """
    from dssmsg.errors import InputError, NotUnderstood, PluginError
    from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA, target_graph_request
    from dssmsg.target_graph import parse_target_graph

    try:
        answer = llm.complete("target_graph", target_graph_request(sentence), TARGET_GRAPH_SCHEMA)
    except NotUnderstood as error:
        raise InputError(error.reason, key=key) from error
    try:
        return parse_target_graph(sentence, answer.value)
    except ValueError as error:
        raise PluginError(str(error), plugin=f"llm/{config.llm.use}") from error
