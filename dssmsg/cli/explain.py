"""`dssmsg explain`: why a recording says what it says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssmsg.cli.options import ConfigOption, JsonOption, SetOption
from dssmsg.cli.recordings import RecordingArgument, chosen

if TYPE_CHECKING:
    from dssmsg.recording.reader import Recording


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def explain(
        recording: RecordingArgument = None,
        episode: Annotated[
            int | None,
            typer.Option(
                "--episode", metavar="N", min=0, help="Why an episode went as it did; 0 is the first."
            ),
        ] = None,
        object_id: Annotated[
            str | None,
            typer.Option("--object", metavar="ID", help="The life of an object, like object-12."),
        ] = None,
        query: Annotated[
            str | None,
            typer.Option("--query", metavar="TEXT", help="Why a viewpoint won a goal, or a new sentence."),
        ] = None,
        no_truth: Annotated[
            bool, typer.Option("--no-truth", help="Reason as if no truth had been recorded.")
        ] = False,
        config: ConfigOption = None,
        sets: SetOption = None,
        as_json: JsonOption = False,
    ) -> None:
        """Say why an episode went wrong or a viewpoint won, or tell the life of an object.

        With --episode: the guilty layer, the first frame where things went wrong, the chain of events from
        there, the score that decided, and the command that opens the viewer there. The rules that look for it
        are those of the configuration (`diagnosis`), all installed ones where it names none.

        With --query: the winner term by term against the runner-up; a sentence that was no goal of the run is
        grounded anew, by the plug-ins of the configuration.

        \b
        Examples:
          dssmsg explain --episode 0
          dssmsg explain recordings/run.rrd --object object-12 --json
          dssmsg explain --query "a place to wash up"
        """
        from dssmsg.errors import ConfigError

        if [episode, object_id, query].count(None) != 2:
            raise ConfigError(
                'say one thing to explain: --episode 0, --object object-12 or --query "the sofa"',
                key="--episode",
            )
        for key, given, expected in (("--query", query, "a sentence"), ("--object", object_id, "an id")):
            if given is not None and not given.strip():
                raise ConfigError(f"expected {expected}", key=key)
        if query is not None:
            show_query_explained(recording, query, config, sets or (), as_json=as_json)
        elif object_id is not None:
            show_explanation(recording, object_id, as_json=as_json)
        elif episode is not None:
            show_episode(recording, episode, config, sets or (), no_truth=no_truth, as_json=as_json)


def show_explanation(recording: Path | None, object_id: str, *, as_json: bool) -> None:
    """Print the life of an object of a recording (a path, or None for the newest)."""
    from dssmsg.cli.output import print_json, show
    from dssmsg.cli.recordings import warn_of_cuts
    from dssmsg.recording.reader import Recording
    from dssmsg.review.life import life_of, life_text

    path = chosen(recording)
    with Recording.open(path) as opened:
        warn_of_cuts(opened)
        life = life_of(opened, object_id)
    if as_json:
        print_json({"recording": str(path), **life.to_json()})
    else:
        show(life_text(life))


def show_episode(
    recording: Path | None,
    episode: int,
    config: Path | None,
    sets: Sequence[str],
    *,
    no_truth: bool,
    as_json: bool,
) -> None:
    """Print what the rules of the configuration make of an episode."""
    from dssmsg.cli.output import print_json, show, stdout_to_stderr
    from dssmsg.cli.recordings import warn_of_cuts

    path = chosen(recording)
    with stdout_to_stderr():
        from dssmsg.cli.plugins import warn_of_failures
        from dssmsg.config import load_config
        from dssmsg.evaluate.diagnosis_rules import RULES, build_rules
        from dssmsg.host import Host
        from dssmsg.review.diagnosis import diagnose, diagnosed_json, diagnosed_text
        from dssmsg.review.episode import ReviewedRecording

        resolved = load_config(config, sets=sets)
        with resolved.naming_files():
            host = Host.load(resolved.plugins, resolved.base_dir, kinds=RULES)
            rules = build_rules(resolved, host)
        warn_of_failures(host)
        with ReviewedRecording.open(path) as opened:
            opened.hides_truth = no_truth
            warn_of_cuts(opened)
            found = diagnose(opened, episode, rules)
    if as_json:
        print_json(diagnosed_json(str(path), found))
    else:
        show(diagnosed_text(str(path), found))


def show_query_explained(
    recording: Path | None, sentence: str, config: Path | None, sets: Sequence[str], *, as_json: bool
) -> None:
    """Print why the best viewpoint for a sentence won: as recorded, else grounded anew at the end."""
    from dssmsg.cli.output import print_json, show, stdout_to_stderr
    from dssmsg.cli.recordings import warn_of_cuts

    path = chosen(recording)
    with stdout_to_stderr():
        from dssmsg.recording.reader import Recording
        from dssmsg.review.explain_query import explain_match, query_explained_json, query_explained_text
        from dssmsg.review.match import whole_match

        with Recording.open(path) as opened:
            warn_of_cuts(opened)
            match = next((one for one in reversed(opened.matches()) if one["query"] == sentence), None)
            if match is not None:
                options = opened.config.get("grounding", {})
                told = explain_match(whole_match(match, path), options, recorded=True)
            else:
                told = explain_match(*_grounded_anew(opened, sentence, config, sets), recorded=False)
    if as_json:
        print_json(query_explained_json(str(path), told))
    else:
        show(query_explained_text(str(path), told))


def _grounded_anew(
    recording: Recording, sentence: str, config: Path | None, sets: Sequence[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A sentence against the map at the end of a recording: the match, and the options of the grounding."""
    from dssmsg import checks
    from dssmsg.cli.query import plugins_over, target_of
    from dssmsg.config import load_config
    from dssmsg.host import Host
    from dssmsg.target_graph import target_graph_json

    resolved = load_config(config, sets=sets)
    graph = recording.graph_at()
    llm, grounding = plugins_over(resolved, recording, graph)
    target = target_of(llm, sentence, resolved, key="--query")
    candidates = checks.check_candidates(graph, grounding.ground(target))
    with resolved.naming_files():
        host = Host.load(resolved.plugins, resolved.base_dir)
        _, options = host.resolve("grounding", resolved.grounding, resolved.base_dir)
    match = {
        "query": sentence,
        "frame": recording.last_known_frame or 0,
        "target": target_graph_json(target),
        "candidates": [
            {
                "viewpoint": one.viewpoint_id,
                "rank": one.rank,
                "scores": dict(one.scores),
                "matching": dict(one.matching),
                "reason": one.reason,
            }
            for one in candidates
        ],
    }
    return match, {"use": resolved.grounding.use, **options.model_dump(mode="json")}
