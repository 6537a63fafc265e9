"""llm/anthropic: messages of Anthropic's models, or of a server that speaks their protocol."""

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

PACKAGE = "anthropic"
ADDRESS = "https://api.anthropic.com"
KEY_VARIABLE = "ANTHROPIC_API_KEY"


class Config(KeyedOptions):
    """Options of `llm: {use: anthropic}`."""

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """What this machine lacks, for `dssmsg doctor`."""
        return missing_parts(self, base_dir, PACKAGE, KEY_VARIABLE)


class AnthropicLlm(RemoteLlm):
    """One message a request. Raises ConfigError where the package or the key is missing."""

    def __init__(
        self, config: Config, context: Context, *, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        try:
            import anthropic

            from dssmsg.llm.http import client_options
        except ModuleNotFoundError:
            raise ConfigError(needs(PACKAGE), key=".use") from None
        key = config.key(context.base_dir, KEY_VARIABLE)
        super().__init__("anthropic", config, context, keys=[key], sleep=sleep)
        self._config = config
        options = client_options(config.timeout_secs, config.max_answer_bytes)
        client = anthropic.Anthropic(
            # Without one the client takes a variable's or a profile's, which is for Anthropic alone.
            api_key=key or "none",
            base_url=config.base_url or ADDRESS,
            max_retries=0,
            timeout=config.timeout_secs,
            http_client=anthropic.DefaultHttpxClient(**options),
        )
        # Named here, since the library imports it on the way, which is not to count as the server's time.
        self._create = client.messages.with_raw_response.create

    def send(
        self, messages: Sequence[Message], schema: Mapping[str, Any], secs: float, *, structured: bool
    ) -> Reply:
        """One request; see `RemoteLlm.send`."""
        from dssmsg.llm.http import json_body

        strict = strict_schema(schema) if structured else None
        system = [one.content for one in messages if one.role == "system"]
        request: dict[str, Any] = {"model": self._config.model, "max_tokens": self._config.max_tokens}
        if strict is not None:
            request["output_config"] = {"format": {"type": "json_schema", "schema": strict}}
        else:
            system.append(schema_words(schema))
        if system:
            request["system"] = "\n\n".join(system)
        request["messages"] = [
            {"role": one.role, "content": one.content} for one in messages if one.role != "system"
        ]
        # The client no longer knows a temperature: recent models take none, older and compatible ones do.
        sampling = {} if self._config.temperature is None else {"temperature": self._config.temperature}
        extra = {**sampling, **self._config.extra}
        try:
            raw = self._create(**request, extra_body=extra or None, timeout=secs)
        except Exception as error:
            raise fault_of(error) from None
        return _reply(json_body(raw.http_response), lower(raw.headers))


def _reply(body: Mapping[str, Any], headers: Mapping[str, str]) -> Reply:
    """The text blocks of a message. Raises ProviderFault where there are none."""
    blocks, end = body.get("content"), body.get("stop_reason")
    if not isinstance(blocks, list):
        raise ProviderFault("the body is no message", retry=True, headers=headers)
    texts = [one.get("text") for one in blocks if isinstance(one, dict) and one.get("type") == "text"]
    text = "".join(one for one in texts if isinstance(one, str))
    if end == "refusal" or not text:
        raise ProviderFault(f"no text (stop_reason: {end})", retry=False, headers=headers)
    usage = body.get("usage")
    counts = [usage.get("input_tokens"), usage.get("output_tokens")] if isinstance(usage, dict) else []
    known = [one for one in counts if isinstance(one, int)]
    cut = "cut off at max_tokens" if end == "max_tokens" else ""
    return Reply(text, sum(known) if known else None, headers, cut)


@hookimpl
def register_llm(register: Register) -> None:
    """`anthropic`: Anthropic's models."""
    register("anthropic", AnthropicLlm, config=Config)
