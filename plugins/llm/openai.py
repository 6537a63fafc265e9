"""llm/openai: chat completions of OpenAI or any server that speaks its protocol.

`base_url` leads to vLLM, Ollama, llama.cpp or a hosted service; the official client does the talking.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dssmsg.errors import ConfigError
from dssmsg.hookspecs import Register, hookimpl
from dssmsg.interfaces import Encoder
from dssmsg.interfaces.llm import Message
from dssmsg.llm.faults import fault_of, lower
from dssmsg.llm.options import KeyedOptions, missing_parts, needs
from dssmsg.llm.provider import ProviderFault, Reply
from dssmsg.llm.remote import RemoteLlm
from dssmsg.llm.wire_schema import schema_words, strict_schema

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PACKAGE = "openai"
ADDRESS = "https://api.openai.com/v1"
KEY_VARIABLE = "OPENAI_API_KEY"


class Config(KeyedOptions):
    """Options of `llm: {use: openai}`."""

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """What this machine lacks, for `dssmsg doctor`."""
        return missing_parts(self, base_dir, PACKAGE, KEY_VARIABLE)


class OpenAiLlm(RemoteLlm):
    """One chat completion a request. Raises ConfigError where the package or the key is missing."""

    def __init__(
        self, config: Config, context: Context, *, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        try:
            import openai

            from dssmsg.llm.http import client_options
        except ModuleNotFoundError:
            raise ConfigError(needs(PACKAGE), key=".use") from None
        key = config.key(context.base_dir, KEY_VARIABLE)
        super().__init__("openai", config, context, keys=[key], sleep=sleep)
        self._config = config
        options = client_options(config.timeout_secs, config.max_answer_bytes)
        client = openai.OpenAI(
            # Without one the client takes a variable's, which is for OpenAI alone.
            api_key=key or "none",
            base_url=config.base_url or ADDRESS,
            max_retries=0,
            timeout=config.timeout_secs,
            http_client=openai.DefaultHttpxClient(**options),
        )
        # Named here, since the library imports it on the way, which is not to count as the server's time.
        self._create = client.chat.completions.with_raw_response.create

    def send(
        self, messages: Sequence[Message], schema: Mapping[str, Any], secs: float, *, structured: bool
    ) -> Reply:
        """One request; see `RemoteLlm.send`."""
        from dssmsg.llm.http import json_body

        strict = strict_schema(schema) if structured else None
        turns = [{"role": one.role, "content": one.content} for one in messages]
        request: dict[str, Any] = {"model": self._config.model}
        if strict is not None:
            form = {"name": "answer", "strict": True, "schema": strict}
            request["response_format"] = {"type": "json_schema", "json_schema": form}
        else:
            turns.insert(0, {"role": "system", "content": schema_words(schema)})
        request["messages"] = turns
        # OpenAI renamed the limit; the servers that copied its protocol know the old name.
        limit = "max_tokens" if self._config.base_url else "max_completion_tokens"
        request[limit] = self._config.max_tokens
        if self._config.temperature is not None:
            request["temperature"] = self._config.temperature
        try:
            raw = self._create(**request, extra_body=self._config.extra or None, timeout=secs)
        except Exception as error:
            raise fault_of(error) from None
        return _reply(json_body(raw.http_response), lower(raw.headers))


def _reply(body: Mapping[str, Any], headers: Mapping[str, str]) -> Reply:
    """The first choice of a completion. Raises ProviderFault where there is none."""
    try:
        choice = body["choices"][0]
        text, end = choice["message"].get("content"), choice.get("finish_reason")
        refusal = choice["message"].get("refusal")
    except (KeyError, IndexError, TypeError, AttributeError):
        raise ProviderFault("the body is no chat completion", retry=True, headers=headers) from None
    if refusal or not isinstance(text, str):
        said = f"it refused: {refusal}" if refusal else f"no text (finish_reason: {end})"
        raise ProviderFault(said, retry=False, headers=headers)
    usage = body.get("usage")
    total = usage.get("total_tokens") if isinstance(usage, dict) else None
    cut = "cut off at max_tokens" if end == "length" else ""
    return Reply(text, total if isinstance(total, int) else None, headers, cut)


@hookimpl
def register_llm(register: Register) -> None:
    """`openai`: OpenAI and compatible servers."""
    register("openai", OpenAiLlm, config=Config)
