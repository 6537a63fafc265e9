"""llm/scripted: answers written down beforehand, for tests, demonstrations and awkward cases.

An answer is a JSON value, or a text that is taken as the raw answer of a model: prose and broken JSON fail
just as they would.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from dssmsg.config_yaml import read_yaml
from dssmsg.errors import ConfigError, PluginError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces import Encoder
from dssmsg.interfaces.llm import Answer, Message
from dssmsg.llm_requests import parse_answer

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "llm/scripted"
_Script = dict[str, list[dict[str, Any] | str]]


class Config(PluginConfig):
    """Options of `llm: {use: scripted}`."""

    answers: _Script = Field(
        default_factory=dict,
        description="By role (target_graph, dynamic_attribute): answers in order, JSON values or raw texts.",
    )
    file: str | None = Field(None, description="A YAML or JSON file with the answers, instead of `answers`.")
    repeat: bool = Field(
        True, description="Whether the last answer of a role is given again when they run out."
    )

    @model_validator(mode="after")
    def _one_script(self) -> Config:
        if bool(self.answers) == (self.file is not None):
            raise ValueError("expected either answers or file")
        return self

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """What this machine lacks, for `dssmsg doctor`."""
        if self.file is None or (base_dir / self.file).is_file():
            return []
        return [f"file: {base_dir / self.file}: no such file"]


class Scripted:
    """Gives the answers of each role in order."""

    def __init__(self, config: Config, context: Context) -> None:
        self._answers = config.answers if config.file is None else _read(config.file, context)
        self._repeat = config.repeat
        self._given: dict[str, int] = {}

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The next answer of the role. Raises PluginError if there is none, or it does not fit the schema."""
        answers = self._answers.get(role, [])
        given = self._given.get(role, 0)
        if not answers or (given >= len(answers) and not self._repeat):
            raise PluginError(f"no answer left for {role}, {given} were given", plugin=PLUGIN)
        self._given[role] = given + 1
        answer = answers[min(given, len(answers) - 1)]
        text = answer if isinstance(answer, str) else json.dumps(answer)
        try:
            return Answer(parse_answer(text, schema), text)
        except ValueError as error:
            raise PluginError(str(error), plugin=PLUGIN) from None


def _read(name: str, context: Context) -> _Script:
    path = context.base_dir / name
    try:
        script = read_yaml(path)
        if not script:
            raise ConfigError("holds no answers", file=path)
        return TypeAdapter(_Script).validate_python(script)
    except ConfigError as error:
        error.key = ".file"
        raise
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "file"
        raise ConfigError(f"{place}: {first['msg']}", file=path, key=".file") from None


@hookimpl
def register_llm(register: Register) -> None:
    """`scripted`: answers from the configuration or a file."""
    register("scripted", Scripted, config=Config)
