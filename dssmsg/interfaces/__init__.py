"""One Protocol a plug-in kind, one file a kind; `KINDS` maps a kind's name to its Protocol."""

from __future__ import annotations

from collections.abc import Mapping

from dssmsg.interfaces.association import Association
from dssmsg.interfaces.context import Context
from dssmsg.interfaces.diagnosis import Diagnosis, Finding
from dssmsg.interfaces.encoder import Encoder
from dssmsg.interfaces.grounding import Grounding, TargetEdge, TargetGraph, TargetNode
from dssmsg.interfaces.llm import Answer, Exchange, Llm, Message, TellsExchanges
from dssmsg.interfaces.navigation import FeelsTouch, Navigation, Step, WatchesFloor
from dssmsg.interfaces.observer import Observer
from dssmsg.interfaces.perception import Box, Detector, Perception, Segmenter, Tagger
from dssmsg.interfaces.source import Command, Source, SourceInfo, Stop
from dssmsg.interfaces.update import Update, UpdateResult

KINDS: Mapping[str, type] = {
    "source": Source,
    "perception": Perception,
    "tagger": Tagger,
    "detector": Detector,
    "segmenter": Segmenter,
    "encoder": Encoder,
    "llm": Llm,
    "association": Association,
    "update": Update,
    "grounding": Grounding,
    "navigation": Navigation,
    "diagnosis": Diagnosis,
    "observer": Observer,
}

__all__ = [
    "KINDS",
    "Answer",
    "Association",
    "Box",
    "Command",
    "Context",
    "Detector",
    "Diagnosis",
    "Encoder",
    "Exchange",
    "FeelsTouch",
    "Finding",
    "Grounding",
    "Llm",
    "Message",
    "Navigation",
    "Observer",
    "Perception",
    "Segmenter",
    "Source",
    "SourceInfo",
    "Step",
    "Stop",
    "Tagger",
    "TargetEdge",
    "TargetGraph",
    "TargetNode",
    "TellsExchanges",
    "Update",
    "UpdateResult",
    "WatchesFloor",
]
