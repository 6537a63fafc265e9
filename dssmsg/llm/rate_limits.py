"""What a server's headers say about when to ask again.

`Retry-After` (seconds or a date, RFC 9110 10.2.3), `retry-after-ms`, and the reset headers of the two
protocols: `x-ratelimit-reset-requests: 6m0s` (OpenAI) and `anthropic-ratelimit-requests-reset:
2026-01-01T00:00:00Z` (Anthropic), for requests and for tokens.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

LONGEST_SECS = 3600.0
"""No header makes us wait longer: beyond an hour it is a mistake, or another run's business."""

_SPAN = re.compile(r"(\d+(?:\.\d+)?)(ms|h|m|s)")
_SECONDS = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 0.001}
_PAIRS = tuple(
    (f"{prefix}-remaining-{what}", f"{prefix}-reset-{what}")
    for prefix in ("x-ratelimit",)
    for what in ("requests", "tokens")
) + tuple(
    (f"anthropic-ratelimit-{what}-remaining", f"anthropic-ratelimit-{what}-reset")
    for what in ("requests", "tokens", "input-tokens", "output-tokens")
)
"""(how many are left, when there are more again)."""


def wait_secs(headers: Mapping[str, str], now: datetime | None = None) -> float | None:
    """Seconds that a refused request shall wait; None where the server does not say."""
    spans = [_milliseconds(headers.get("retry-after-ms", "")), _until(headers.get("retry-after", ""), now)]
    asked = next((span for span in spans if span is not None), None)
    return quiet_secs(headers, now) if asked is None else min(asked, LONGEST_SECS)


def quiet_secs(headers: Mapping[str, str], now: datetime | None = None) -> float | None:
    """Seconds until a limit that is used up is lifted; None where nothing is used up."""
    spans = list(_resets(headers, now))
    return min(max(spans), LONGEST_SECS) if spans else None


def _resets(headers: Mapping[str, str], now: datetime | None) -> Iterator[float]:
    for remaining, reset in _PAIRS:
        if headers.get(remaining, "").strip() == "0":
            span = _until(headers.get(reset, ""), now)
            if span is not None:
                yield span


def _milliseconds(text: str) -> float | None:
    seconds = _number(text)
    return None if seconds is None else seconds / 1000


def _until(text: str, now: datetime | None) -> float | None:
    """Seconds of `2`, `6m0s`, an HTTP date or an ISO date; None for anything else."""
    text = text.strip()
    seconds = _number(text)
    if seconds is not None:
        return seconds
    if text and not _SPAN.sub("", text):
        return sum(float(amount) * _SECONDS[unit] for amount, unit in _SPAN.findall(text))
    date = _date(text)
    if date is None:
        return None
    return max(0.0, (date - (now or datetime.now(UTC))).total_seconds())


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) and number >= 0 else None


def _date(text: str) -> datetime | None:
    for parse in (datetime.fromisoformat, parsedate_to_datetime):
        try:
            date = parse(text)
        except (ValueError, TypeError, IndexError, OverflowError):  # the parsers' own words for "no date"
            continue
        return date if date.tzinfo is not None else date.replace(tzinfo=UTC)
    return None
