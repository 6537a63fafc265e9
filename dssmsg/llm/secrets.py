"""Keys: read from the environment or a file, and kept out of everything that is written down."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from dssmsg.errors import ConfigError

HIDDEN = "[key]"
_SHORTEST = 6
"""Shorter values are no keys; hiding them would blacken words."""
_LOOKS_LIKE_A_KEY = re.compile(r"\b(?:sk|pk|rk|gsk|hf|xai)[-_][A-Za-z0-9_*.-]{8,}|\bBearer\s+[^\s\"',}]+")
_NAMED_LIKE_A_KEY = re.compile(r"(?:KEY|TOKEN|SECRET|PASSWORD)$", re.IGNORECASE)
_NAME = re.compile(r"[A-Z_][A-Z0-9_]{0,63}")


class Redactor:
    """Replaces known keys, and what looks like one, in a text."""

    def __init__(self, keys: Iterable[str | None] = ()) -> None:
        # The longest first: one key may begin with another.
        known = {key for key in keys if key is not None and len(key) >= _SHORTEST}
        self._keys = tuple(sorted(known, key=len, reverse=True))

    def __call__(self, text: str) -> str:
        """The text without keys, and without halves of characters, which no file can hold."""
        for key in self._keys:
            text = text.replace(key, HIDDEN)
        return _LOOKS_LIKE_A_KEY.sub(HIDDEN, text).encode("utf-8", "replace").decode("utf-8")


def environment_secrets(environment: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """The values of all variables that are named like a key: `OPENAI_API_KEY`, `MY_TOKEN`.

    Plain words and paths are left out, or a variable `X_KEY=default` would blacken that word in every prompt.
    """
    found = os.environ if environment is None else environment
    named = (value.strip() for name, value in found.items() if _NAMED_LIKE_A_KEY.search(name))
    return tuple(value for value in named if value and not value.isalpha() and not value.startswith("/"))


def check_variable(name: str | None) -> str | None:
    """`name` if a variable may be called so; ValueError otherwise, without the name: it may be the key."""
    if name is not None and not _NAME.fullmatch(name):
        raise ValueError("expected the name of an environment variable, such as OPENAI_API_KEY, not a key")
    return name


def read_key(variable: str | None, file: str | None, base_dir: Path) -> str | None:
    """The key in a file (relative to `base_dir`), else in an environment variable; None if neither is named.

    Raises ConfigError naming the option where there is none, or it is no key. The key is in no message.
    """
    if file is not None:
        path, option = base_dir / Path(file).expanduser(), ".api_key_file"
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is no text"
            raise ConfigError(f"the key cannot be read: {reason}", file=path, key=option) from None
        place: str = str(path)
    elif variable is not None:
        text, place, option = os.environ.get(variable, ""), f"variable {variable}", ".api_key_env"
    else:
        return None
    key = text.strip()
    if not key:
        raise ConfigError(f"no key: {place} is not set or empty", key=option)
    if not key.isascii() or any(one.isspace() or not one.isprintable() for one in key):
        raise ConfigError(f"{place} holds no key: one word of ASCII letters and signs is one", key=option)
    return key
