"""llm/llm: any model that the `llm` library knows, through it or through one of its plug-ins.

The library finds its keys itself, in its own key file or in the variable of the model's provider.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.hookspecs import Register, hookimpl
from dssmsg.interfaces import Encoder
from dssmsg.interfaces.llm import Message
from dssmsg.llm.faults import fault_of
from dssmsg.llm.options import RemoteOptions, missing_package, needs
from dssmsg.llm.provider import ProviderFault, Reply
from dssmsg.llm.remote import RemoteLlm
from dssmsg.llm.wire_schema import schema_words, strict_schema

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PACKAGE = "llm"


class Config(RemoteOptions):
    """Options of `llm: {use: llm}`."""

    options: dict[str, Any] = Field(
        default_factory=dict, description="Options of the model, as `llm models --options` lists them."
    )

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """What this machine lacks, for `dssmsg doctor`."""
        missing = list(missing_package("model", PACKAGE))
        return missing or list(self._of_model())

    def _of_model(self) -> Iterator[str]:
        try:
            model = _model(self.model)
        except ConfigError as error:
            yield f"model: {error.message}"
            return
        if model.needs_key and not _key(model):
            yield f"model: no key; {_key_hint(model)}"


class LibraryLlm(RemoteLlm):
    """One prompt a request. Raises ConfigError where the package, the model or its key is missing."""

    def __init__(
        self, config: Config, context: Context, *, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._model = _model(config.model)
        key = _key(self._model)
        if self._model.needs_key and not key:
            raise ConfigError(f"no key; {_key_hint(self._model)}", key=".model")
        try:
            self._model.Options(**config.options)
        except ValueError as error:
            lines = [line.strip() for line in str(error).splitlines()[1:3]]
            raise ConfigError(f"{config.model}: {': '.join(lines)}", key=".options") from None
        super().__init__("llm", config, context, keys=[key], sleep=sleep)
        self._config = config

    def send(
        self, messages: Sequence[Message], schema: Mapping[str, Any], secs: float, *, structured: bool
    ) -> Reply:
        """One request; see `RemoteLlm.send`."""
        strict = strict_schema(schema) if structured and self._model.supports_schema else None
        system = [one.content for one in messages if one.role == "system"]
        if strict is None:
            system.append(schema_words(schema))
        try:
            response = self._model.prompt(
                _as_one_text(messages),
                system="\n\n".join(system),
                schema=strict,
                stream=self._model.can_stream,
                **self._config.options,
            )
            parts, length = [], 0
            for part in response:
                parts.append(part)
                length += len(part)
                if length > self._config.max_answer_bytes:
                    raise ProviderFault(
                        f"the answer is longer than {self._config.max_answer_bytes} (max_answer_bytes)",
                        retry=False,
                    )
            usage = response.usage()
        except ProviderFault:
            raise
        except Exception as error:
            raise fault_of(error) from None
        known = [one for one in (usage.input, usage.output) if isinstance(one, int)]
        return Reply("".join(parts), sum(known) if known else None)


def _model(name: str) -> Any:
    """A model of the library by name or alias. Raises ConfigError naming what is missing."""
    try:
        import llm
    except ModuleNotFoundError:
        raise ConfigError(needs(PACKAGE), key=".use") from None
    try:
        return llm.get_model(name)
    except llm.UnknownModelError:
        some = ", ".join(sorted(one.model_id for one in llm.get_models())[:8])
        raise ConfigError(
            f"the llm library knows no model '{name}'; `llm models` lists them all (some: {some})",
            key=".model",
        ) from None


def _key(model: Any) -> str | None:
    import llm

    if not model.needs_key:
        return None
    key: str | None = llm.get_key(alias=model.needs_key, env=model.key_env_var)
    return key


def _key_hint(model: Any) -> str:
    variable = f" or set the variable {model.key_env_var}" if model.key_env_var else ""
    return f"llm keys set {model.needs_key}{variable}"


def _as_one_text(messages: Sequence[Message]) -> str:
    """The turns as one prompt: not every model of the library takes a conversation."""
    turns = [one for one in messages if one.role != "system"]
    if len(turns) == 1:
        return turns[0].content
    names = {"assistant": "You answered", "user": "The user wrote"}
    return "\n\n".join(f"{names[one.role]}:\n{one.content}" for one in turns)


@hookimpl
def register_llm(register: Register) -> None:
    """`llm`: the models of the `llm` library."""
    register("llm", LibraryLlm, config=Config)
