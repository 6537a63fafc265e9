"""Faults of the detector: what is asked for is missed, called otherwise, or something else is called so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dssmsg.evaluate.faults.host import Aim
from dssmsg.frame import Detection, Frame
from dssmsg.interfaces import Context, Perception


@dataclass(slots=True)
class MissedClass:
    """Nothing of the target's label is ever detected."""

    inner: Perception
    context: Context
    aim: Aim

    @property
    def feature_space(self) -> str | None:
        """The inner one's."""
        return self.inner.feature_space

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """What is left."""
        return [one for one in self.inner.detect(frame) if one.label != self.aim.label]


@dataclass(slots=True)
class WrongLabel:
    """Detections of one label get another one, with its feature. `falsely`: others get the target's."""

    inner: Perception
    context: Context
    aim: Aim
    falsely: bool = False

    @property
    def feature_space(self) -> str | None:
        """The inner one's."""
        return self.inner.feature_space

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """The detections, some renamed."""
        other = self.aim.others[self.aim.seed % len(self.aim.others)]
        old, new = (other, self.aim.label) if self.falsely else (self.aim.label, other)
        return [self._renamed(one, new) if one.label == old else one for one in self.inner.detect(frame)]

    def _renamed(self, one: Detection, label: str) -> Detection:
        feature = one.text_feature
        if feature is not None and self.context.encoder is not None:
            feature = np.asarray(self.context.encoder.encode_labels([label])[0], dtype=np.float32)
        return replace(one, label=label, text_feature=feature)


def false_label(inner: Perception, context: Context, aim: Aim) -> WrongLabel:
    """Things of another kind get the target's label."""
    return WrongLabel(inner, context, aim, falsely=True)
