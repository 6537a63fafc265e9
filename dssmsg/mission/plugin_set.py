"""The plug-ins of a mission, built in the order in which they need each other."""

from __future__ import annotations

from collections.abc import Callable

from dssmsg.config import RunConfig, Slot
from dssmsg.contexts import ContextFactory
from dssmsg.errors import ConfigError
from dssmsg.host import Built, Host
from dssmsg.interfaces import Llm, Observer, Source, SourceInfo
from dssmsg.mission.checked_encoder import CheckedEncoder

BUILD_ORDER = ("encoder", "llm", "perception", "association", "update", "grounding", "navigation")
"""After the source: whatever a kind may ask its context for is built before it."""


class PluginSet:
    """What a configuration names, by kind; the configured observers in their order."""

    def __init__(
        self, config: RunConfig, host: Host, contexts: ContextFactory, logged: Callable[[Built], Llm]
    ) -> None:
        """`logged` puts what records its calls around the language model.

        Raises ConfigError and InputError where a plug-in does not accept its options, or two do not fit.
        """
        self._config = config
        self._host = host
        self._contexts = contexts
        self._built: dict[str, Built] = {}
        with config.naming_files():
            self.source: Source = self._build("source").plugin
            self.info: SourceInfo = self.source.info
            _check_visits(config, self.info)
            contexts.source = self.info
            for kind in BUILD_ORDER:
                built = self._build(kind)
                if kind == "encoder":
                    contexts.encoder = CheckedEncoder(built.plugin, built.registration.id)
                elif kind == "llm":
                    contexts.llm = logged(built)
            self._check_feature_space()
            self.observers: list[tuple[str, Observer]] = [
                (name, self._build_slot("observer", slot, f"recording.observers.{name}").plugin)
                for name, slot in config.recording.observers.items()
            ]

    def __getitem__(self, kind: str) -> Built:
        return self._built[kind]

    def id(self, kind: str) -> str:
        """What errors call the plug-in of a kind."""
        return self._built[kind].registration.id

    def _build(self, kind: str) -> Built:
        built = self._built[kind] = self._build_slot(kind, getattr(self._config, kind), kind)
        return built

    def _build_slot(self, kind: str, slot: Slot, key: str) -> Built:
        built = self._host.build(kind, slot, self._contexts, base_dir=self._config.base_dir, key=key)
        self._contexts.made[key] = built.registration
        return built

    def _check_feature_space(self) -> None:
        perceived = self._built["perception"].plugin.feature_space
        space = self._built["encoder"].plugin.space
        if perceived is not None and perceived != space:
            raise ConfigError(
                f"its features live in the space '{perceived}', the encoder's in '{space}'; "
                "choose an encoder of the same space",
                key="perception.use",
            )


def _check_visits(config: RunConfig, info: SourceInfo) -> None:
    """Each visit needs its tour: a later one begins where the one before ended."""
    visits = sum(phase != "seek" for phase in config.mission.phases)
    if info.drivable and 1 < len(info.tours) < visits:
        raise ConfigError(
            f"asks for {visits} visits, the source has tours for {len(info.tours)}; "
            f"set source.visits to {visits} or more",
            key="mission.phases",
        )
