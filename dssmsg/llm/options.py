"""The options that every provider of a language model has, and what of them is missing on this machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from pydantic import Field, field_validator

from dssmsg.config import Slot
from dssmsg.errors import ConfigError
from dssmsg.hookspecs import PluginConfig
from dssmsg.llm.secrets import check_variable, read_key


class RemoteOptions(PluginConfig):
    """Options of a model that may be slow, down or wrong."""

    model: str = Field(min_length=1, max_length=200, description="Name of the model, as the server knows it.")
    fallback: Slot | None = Field(
        Slot(use="lexicon"), description="The llm that answers where this one fails; null: none does."
    )
    timeout_secs: float = Field(10.0, gt=0, le=3600, description="Seconds for one exchange with the model.")
    budget_secs: float | None = Field(
        None,
        gt=0,
        le=3600,
        description="Seconds for one question, retries included; null: what the run allows.",
    )
    retries: int = Field(2, ge=0, le=10, description="Further tries of a request that may succeed later.")
    backoff_secs: float = Field(
        0.5, ge=0, le=60, description="Wait before the first retry; doubled each time, with jitter."
    )
    max_wait_secs: float = Field(
        8.0, ge=0, le=3600, description="Longest wait a server may ask for; beyond it the fallback answers."
    )
    rest_secs: float = Field(
        30.0, ge=0, le=3600, description="Seconds without questions after one that the server did not answer."
    )
    repair: bool = Field(True, description="Whether a wrong answer is sent back once, with what is wrong.")
    structured: Literal["auto", "schema", "off"] = Field(
        "auto",
        description="Whether the server gets the schema (schema), the prompt does (off), or what works.",
    )
    max_tokens: int = Field(4000, ge=16, le=1_000_000, description="Longest answer, in tokens.")
    max_answer_bytes: int = Field(
        1_000_000, ge=1000, le=100_000_000, description="Longest HTTP body or text that is read."
    )


class KeyedOptions(RemoteOptions):
    """Options of a server that is spoken to over HTTP, with a key."""

    base_url: str | None = Field(
        None, max_length=500, description="Address of a compatible server; null: the provider's own."
    )
    api_key_env: str | None = Field(
        None, description="Variable that holds the key; with base_url none is sent unless named."
    )
    api_key_file: str | None = Field(None, description="A file that holds the key, instead of a variable.")
    temperature: float | None = Field(
        None, ge=0, le=2, description="Sampling temperature; null: the server's default."
    )
    extra: dict[str, Any] = Field(
        default_factory=dict, description="More fields of the request, as the server understands them."
    )

    @field_validator("api_key_env")
    @classmethod
    def _is_a_name(cls, value: str | None) -> str | None:
        return check_variable(value)

    @field_validator("base_url")
    @classmethod
    def _is_an_address(cls, value: str | None) -> str | None:
        if value is None:
            return None
        try:
            parts = urlsplit(value)
            fits = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        except ValueError:
            fits = False
        if not fits or parts.username is not None:
            raise ValueError("expected an address like http://localhost:11434/v1, without user and password")
        return value

    def key(self, base_dir: Path, variable: str) -> str | None:
        """The key to send; `variable` is the provider's usual one, which no other server is given.

        Raises ConfigError naming the option where a key is named or needed and there is none.
        """
        named = self.api_key_env or (None if self.base_url else variable)
        return read_key(named, self.api_key_file, base_dir)


def missing_parts(options: KeyedOptions, base_dir: Path, package: str, variable: str) -> Sequence[str]:
    """For `dssmsg doctor`: the package and the key that are missing; nothing is asked over the network."""
    return [*missing_package("model", package), *_missing_key(options, base_dir, variable)]


def missing_package(option: str, package: str) -> Iterator[str]:
    """The sentence about a client library that is not installed, if so."""
    if find_spec(package) is None:
        yield f"{option}: {needs(package)}"


def needs(package: str) -> str:
    """How to get the client library of a provider."""
    return f"needs the Python package '{package}'; pip install 'dssmsg[{package}]' (or pip install {package})"


def _missing_key(options: KeyedOptions, base_dir: Path, variable: str) -> Iterator[str]:
    try:
        options.key(base_dir, variable)
    except ConfigError as error:
        place = f"{error.file}: " if error.file else ""
        yield f"{(error.key or '.api_key_env').lstrip('.')}: {place}{error.message}"
