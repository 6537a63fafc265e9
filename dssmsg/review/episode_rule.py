"""What rules of diagnosis that ask about one episode share: the options, and the way to the episode."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Generic, TypeVar

from dssmsg.interfaces.diagnosis import Finding
from dssmsg.review.episode import EpisodeCase, ReviewedRecording

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

Config = TypeVar("Config")
"""The options that the rule registers."""


class EpisodeRule(ABC, Generic[Config]):
    """A rule that looks at one episode at a time: a subclass says in `findings` what it finds there.

    Stock rules and those of users are made alike; the class itself is the factory to register:

        class Waits(EpisodeRule[PluginConfig]):
            def findings(self, case: EpisodeCase) -> Iterator[Finding]:
                if not case.moves:
                    yield Finding("control", case.last, 0.9, "it never moved")

        register("waits", Waits)
    """

    def __init__(self, config: Config, context: Context | None = None) -> None:
        self.config = config

    def diagnose(self, recording: ReviewedRecording, episode: int | None) -> Sequence[Finding]:
        """The findings of an episode; none for a whole run. Raises InputError where there is no such one."""
        return () if episode is None else tuple(self.findings(recording.case(episode)))

    @abstractmethod
    def findings(self, case: EpisodeCase) -> Iterable[Finding]:
        """What speaks against a layer in an episode, most telling first."""
