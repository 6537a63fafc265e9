"""The plug-in contract on one page: one `register_<kind>` hook a kind.

A plug-in is a module (or object) with any of these functions, marked `@hookimpl`. Each is called once
with a `register` function and says which names it provides; nothing is built until a run wants it:

    from dssmsg.hookspecs import PluginConfig, hookimpl

    class Config(PluginConfig):
        threshold: float = 0.5

    @hookimpl
    def register_perception(register):
        register("mine", lambda config, context: MyDetector(config), config=Config)

A factory gets the validated, frozen config and a `dssmsg.interfaces.Context`; heavy imports belong
inside it. What it returns must satisfy the kind's Protocol in `dssmsg.interfaces`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import pluggy
from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PROJECT = "dssmsg"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


class PluginConfig(BaseModel):
    """Base of every plug-in's options: frozen, unknown keys refused, non-finite numbers refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Factory = Callable[[Any, "Context"], Any]


class Register(Protocol):
    """What a hook is given to announce a plug-in."""

    def __call__(
        self,
        name: str,
        factory: Factory,
        *,
        config: type[PluginConfig] = PluginConfig,
        needs_truth: bool = False,
    ) -> None:
        """Announce `name`; with `needs_truth` its frames keep the simulator's truth."""
        ...


@hookspec
def register_source(register: Register) -> None:
    """Gives frames, takes commands: `dssmsg.interfaces.Source`."""


@hookspec
def register_perception(register: Register) -> None:
    """Frame -> detections: `dssmsg.interfaces.Perception`."""


@hookspec
def register_tagger(register: Register) -> None:
    """Frame -> label texts, the first link of a chain: `dssmsg.interfaces.Tagger`."""


@hookspec
def register_detector(register: Register) -> None:
    """Frame + labels -> boxes: `dssmsg.interfaces.Detector`."""


@hookspec
def register_segmenter(register: Register) -> None:
    """Frame + boxes -> masks: `dssmsg.interfaces.Segmenter`."""


@hookspec
def register_encoder(register: Register) -> None:
    """Text (and crops, where it can) -> unit vectors: `dssmsg.interfaces.Encoder`."""


@hookspec
def register_llm(register: Register) -> None:
    """Messages + JSON schema -> validated object: `dssmsg.interfaces.Llm`."""


@hookspec
def register_association(register: Register) -> None:
    """Observations + graph -> changes: `dssmsg.interfaces.Association`."""


@hookspec
def register_update(register: Register) -> None:
    """Windows, dynamics and re-navigation updates -> changes: `dssmsg.interfaces.Update`."""


@hookspec
def register_grounding(register: Register) -> None:
    """Target graph + graph -> ranked viewpoints with reasons: `dssmsg.interfaces.Grounding`."""


@hookspec
def register_navigation(register: Register) -> None:
    """Graph + goal + frame -> command and edge changes: `dssmsg.interfaces.Navigation`."""


@hookspec
def register_diagnosis(register: Register) -> None:
    """Read model of a recording -> evidence for a cause: `dssmsg.interfaces.Diagnosis`."""


@hookspec
def register_observer(register: Register) -> None:
    """Is told everything that happens: `dssmsg.interfaces.Observer`."""
