"""llm/recorded: what an LLM answered in an earlier run, found by the hash of the request."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from dssmsg.errors import PluginError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces import Encoder
from dssmsg.interfaces.llm import Answer, Message
from dssmsg.llm_requests import parse_answer, request_hash

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "llm/recorded"


class Config(PluginConfig):
    """Options of `llm: {use: recorded}`."""

    recording: str = Field(
        description="The .rrd file whose answers are given again (relative to the configuration file), or a "
        "folder: its newest."
    )

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """What this machine lacks, for `dssmsg doctor`."""
        path = base_dir / self.recording
        return [] if path.exists() else [f"recording: {path}: no such file or folder"]


class Recorded:
    """Gives recorded answers, those of a fallback too; no server is asked.

    Where a request was made more than once, its answers come in their order, and the last one again after
    that. Raises InputError if the recording does not read.
    """

    def __init__(self, config: Config, context: Context) -> None:
        from dssmsg.recording.reader import Recording, newest

        path = context.base_dir / config.recording
        with Recording.open(newest(path) if path.is_dir() else path) as recording:
            calls = recording.llm_calls()
            self._path = recording.path
        self._answers: dict[str, list[tuple[str, int | None]]] = {}
        for call in calls:
            if call["ok"]:
                answer = (str(call["answer"]), call.get("tokens"))
                self._answers.setdefault(call["request_hash"], []).append(answer)
        self._given: Counter[str] = Counter()

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The recorded answer to the same request. Raises PluginError if it was not asked then."""
        key = request_hash(role, messages, schema)
        answers = self._answers.get(key)
        if answers is None:
            count = sum(map(len, self._answers.values()))
            raise PluginError(
                f"holds no answer to this {role} request; it has {count} answers",
                plugin=PLUGIN,
                file=self._path,
            )
        text, tokens = answers[min(self._given[key], len(answers) - 1)]
        self._given[key] += 1
        try:
            return Answer(parse_answer(text, schema), text, tokens)
        except ValueError as error:
            raise PluginError(str(error), plugin=PLUGIN, file=self._path) from None


@hookimpl
def register_llm(register: Register) -> None:
    """`recorded`: the answers of an earlier run."""
    register("recorded", Recorded, config=Config)
