"""llm/recorded: what an LLM answered in an earlier run, found by the hash of the request."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from pydantic import Field

from dssmsg.config import Slot
from dssmsg.errors import PluginError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces import Encoder
from dssmsg.interfaces.llm import Answer, Exchange, Llm, Message
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
    fallback: Slot | None = Field(
        None, description="The llm that answers what was never asked then; null: none does."
    )

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """What this machine lacks, for `dssmsg doctor`."""
        path = base_dir / self.recording
        return [] if path.exists() else [f"recording: {path}: no such file or folder"]


@dataclass(frozen=True, slots=True)
class _Outcome:
    """How a question ended: with an accepted answer, or with an error."""

    text: str
    tokens: int | None
    error: str


class Recorded:
    """Gives recorded answers, those of a fallback too; no server is asked.

    Where a request was made more than once, its answers come in their order, and the last one again after
    that; a question that found no answer then finds none now. Raises InputError if the recording does not
    read.
    """

    def __init__(self, config: Config, context: Context) -> None:
        from dssmsg.recording.newest import newest
        from dssmsg.recording.reader import Recording

        path = context.base_dir / config.recording
        with Recording.open(newest(path) if path.is_dir() else path) as recording:
            self._outcomes = _outcomes(recording.llm_calls())
            self._path = recording.path
        self._given: Counter[str] = Counter()
        self._fallback: Llm | None = None
        self._fallback_name = ""
        if config.fallback is not None:
            self._fallback = context.build("llm", config.fallback, option="fallback")
            self._fallback_name = config.fallback.use
        self._tell: Callable[[Exchange], None] = lambda exchange: None

    def tell_exchanges(self, tell: Callable[[Exchange], None]) -> None:
        """Call `tell` for every answer from now on, those of the fallback included."""
        self._tell = tell

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The recorded answer to the same request.

        Raises PluginError if it was not asked then and there is no fallback, and if it found no answer then.
        """
        key = request_hash(role, messages, schema)
        outcomes = self._outcomes.get(key)
        if outcomes is None:
            return self._ask_fallback(role, messages, schema)
        outcome = outcomes[min(self._given[key], len(outcomes) - 1)]
        self._given[key] += 1
        error = outcome.error and f"had no answer to this {role} request: {outcome.error}"
        value: Mapping[str, Any] = {}
        if not error:
            try:
                value = parse_answer(outcome.text, schema)
            except ValueError as fault:
                error = str(fault)
        exchange = Exchange("recorded", tuple(messages), outcome.text, error, outcome.tokens)
        self._tell(exchange)
        if error:
            raise PluginError(error, plugin=PLUGIN, file=self._path)
        return Answer(value, outcome.text, outcome.tokens)

    def _ask_fallback(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        asked = tuple(messages)
        if self._fallback is None:
            count = sum(map(len, self._outcomes.values()))
            error = f"holds no answer to this {role} request; it has {count} answers"
            self._tell(Exchange("recorded", asked, error=error))
            raise PluginError(error, plugin=PLUGIN, file=self._path)
        start, name = perf_counter(), self._fallback_name
        try:
            answer = self._fallback.complete(role, messages, schema)
        except Exception as fault:
            error, seconds = f"{type(fault).__name__}: {fault}", perf_counter() - start
            self._tell(Exchange(name, asked, error=error, seconds=seconds, fallback_for="recorded"))
            raise
        seconds = perf_counter() - start
        self._tell(
            Exchange(name, asked, answer.text, "", answer.tokens, seconds=seconds, fallback_for="recorded")
        )
        return answer


def _outcomes(calls: Iterable[Mapping[str, Any]]) -> dict[str, list[_Outcome]]:
    """How each question ended, by the request's hash, in the order of asking.

    Several exchanges (tries, a repair, the fallback) make one question: after one that failed the same
    request comes again at once.
    """
    found: dict[str, list[_Outcome]] = {}
    before: Mapping[str, Any] = {}
    for call in calls:
        asked = found.setdefault(call["request_hash"], [])
        if before.get("request_hash") == call["request_hash"] and not before["ok"]:
            asked.pop()
        error = "" if call["ok"] else str(call.get("error") or "failed")
        asked.append(_Outcome(str(call["answer"]), call.get("tokens"), error))
        before = call
    return found


@hookimpl
def register_llm(register: Register) -> None:
    """`recorded`: the answers of an earlier run."""
    register("recorded", Recorded, config=Config)
