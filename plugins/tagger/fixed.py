"""tagger/fixed: the same labels for every frame, from the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from dssmsg.frame import Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

Label = Annotated[str, Field(min_length=1, max_length=80, pattern=r"\S")]


class Config(PluginConfig):
    """Options of the tagger `fixed`."""

    labels: tuple[Label, ...] = Field(min_length=1, description="Labels to look for, most certain first.")


class FixedTagger:
    """Looks at nothing and names what it was told to."""

    def __init__(self, config: Config) -> None:
        self._labels = config.labels

    def tags(self, frame: Frame) -> Sequence[str]:
        """The configured labels."""
        return self._labels


@hookimpl
def register_tagger(register: Register) -> None:
    """`fixed`: labels from the configuration."""
    register("fixed", lambda config, context: FixedTagger(config), config=Config)
