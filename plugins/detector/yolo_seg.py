"""detector/yolo-seg: boxes and masks by a YOLOv8-seg, YOLO11-seg or YOLOE-seg file of the user's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.frame import Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box
from dssmsg.onnx.matching import identify
from dssmsg.onnx.names import NameList, baked_names, noted_names
from dssmsg.onnx.problems import problems_of
from dssmsg.onnx.scores import ScoreKind
from dssmsg.onnx.session import FilePath, Sha256, Threads, open_model
from dssmsg.onnx.yolo import MASK_CONTRACTS, Limits, Yolo, check_class_ids

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder


class Config(PluginConfig):
    """Options of the detector `yolo-seg`; paths start from the folder of the YAML."""

    model: FilePath = Field(description="The ONNX file.")
    classes: NameList | None = Field(
        None,
        description="Class names in their order, or a text file with one a line; needed where the file "
        "does not name them.",
    )
    min_score: float = Field(0.25, ge=0, le=1, description="Boxes below this score are left out.")
    iou: float = Field(
        0.6, ge=0, le=1, description="A box that overlaps a better one of its class by more is left out."
    )
    across_classes: bool = Field(
        False, description="Boxes of different classes suppress each other too: one name a thing."
    )
    limit: int = Field(100, ge=1, le=1000, description="Most boxes a frame.")
    size: int | None = Field(
        None,
        ge=32,
        le=4096,
        multiple_of=32,
        description="Image size for a file that leaves it open; none: what the file notes, else 640.",
    )
    scores: ScoreKind = Field(
        "auto", description="What the class scores are; auto: logits if one lies outside 0..1."
    )
    threads: Threads = Field(1, description="Threads of the model.")
    sha256: Sha256 | None = Field(None, description="SHA-256 of the file; another file is refused.")

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What is wrong with the file, one sentence each, beginning with the option."""
        return problems_of(lambda: YoloSeg(self, base_dir))


class YoloSeg:
    """Finds its baked classes; labels of a tagger are not asked for."""

    def __init__(self, config: Config, base_dir: Path) -> None:
        """Raises ConfigError or InputError if the file does not fit."""
        self._limits = Limits(config.min_score, config.iou, config.limit, config.across_classes)
        model = open_model(
            config.model, base_dir=base_dir, threads=config.threads, sha256=config.sha256, key=".model"
        )
        binding = identify(model, MASK_CONTRACTS, key=".model")
        noted = noted_names(model, key=".model")
        self._yolo = Yolo(
            binding, classes=None if noted is None else len(noted), size=config.size, scores=config.scores
        )
        self._names = baked_names(model, self._yolo.class_count, config.classes, base_dir)

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Sequence[Box]:
        """Boxes with masks (H, W), best score first."""
        found = check_class_ids(self._yolo.find(frame.rgb, self._limits), len(self._names), padding=False)
        return [Box(one.box, self._names[one.class_id], one.score, one.mask) for one in found]


def make(config: Config, context: Context) -> YoloSeg:
    """The factory."""
    return YoloSeg(config, context.base_dir)


@hookimpl
def register_detector(register: Register) -> None:
    """`yolo-seg`: boxes and masks by a file of the user's."""
    register("yolo-seg", make, config=Config)
