"""A source plug-in that wraps the simulator and takes the truth out of every frame."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict

from dssmsg.hookspecs import PluginConfig, Register, hookimpl


class Config(PluginConfig):
    """The options of the wrapped source, passed on."""

    model_config = ConfigDict(frozen=True, extra="allow")


class Truthless:
    """The source `pybullet`, truth removed."""

    def __init__(self, config: Config, context: Any) -> None:
        self._inner = context.build("source", {"use": "pybullet", **(config.model_extra or {})})

    @property
    def info(self) -> Any:
        """The wrapped source's."""
        return self._inner.info

    def start_visit(self, visit: int) -> None:
        """Passed on."""
        self._inner.start_visit(visit)

    def step(self, command: Any) -> Any:
        """The wrapped source's frame without truth."""
        frame = self._inner.step(command)
        return None if frame is None else frame.without_truth()

    def collisions(self) -> int:
        """The wrapped source's."""
        return int(self._inner.collisions())

    def close(self) -> None:
        """Passed on."""
        self._inner.close()


@hookimpl
def register_source(register: Register) -> None:
    """Announce `truthless`."""
    register("truthless", Truthless, config=Config)
