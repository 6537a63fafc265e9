"""detector/coco: NanoDet-g, trained by its authors on photographs: 80 everyday classes, no training of ours.

The model comes from `dssmsg models get coco`, once, when the user asks; a run never fetches it. It gives
boxes without masks: `segmenter: depth` makes masks of them. After RangiLyu/nanodet (Generalized Focal Loss:
the distance to each side of a box is a distribution over whole strides).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.frame import ByteArray, Float32Array, FloatArray, Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box
from dssmsg.onnx.nms import nms

if TYPE_CHECKING:
    from dssmsg.interfaces import Encoder

MODEL = "coco"
SIDE = 416
STRIDES = (8, 16, 32)
CONSIDERED = 5
"""How many classes of a box are told, the best one among them."""
OUTPUTS = tuple(f"{part}_{stride}" for stride in STRIDES for part in ("cls", "reg"))
MEAN_BGR = np.array([103.53, 116.28, 123.675], dtype=np.float32)
SCALE_BGR = np.array([57.375, 57.12, 58.395], dtype=np.float32)

OUTDOOR = frozenset({
    "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light", "fire hydrant",
    "stop sign", "parking meter", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "frisbee",
    "skis", "snowboard", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard",
})  # fmt: skip
"""What the model knows and rooms do not hold; there it is something else that was taken for it."""

RENAMED: Mapping[str, str] = {
    "potted plant": "plant",
    "mouse": "computer mouse",
    "keyboard": "computer keyboard",
    "remote": "remote control",
    "hair drier": "hair dryer",
}
"""COCO's names that mean something else, or nothing, to a reader who does not know COCO."""

Label = Annotated[str, Field(min_length=1, max_length=80, pattern=r"\S")]


class Config(PluginConfig):
    """Options of the detector `coco`."""

    model: str | None = Field(
        None, description="The converted file where it is not in the cache; none: the cached one."
    )
    score: float = Field(0.35, gt=0, lt=1, description="Least score of a box.")
    nms_iou: float = Field(
        0.5, gt=0, le=1, description="A box falls to a better one of its class that it overlaps by more."
    )
    same_place_iou: float = Field(
        0.7, gt=0, le=1, description="The same for boxes of whatever class: one thing gets one name."
    )
    nested: float = Field(
        0.8,
        gt=0,
        le=1,
        description="Of two boxes of a class, the better one stays where the smaller lies in the larger "
        "by more than this share; 1 keeps both.",
    )
    labels: Literal["indoor", "all"] | tuple[Label, ...] = Field(
        "indoor",
        description="Classes to report: indoor (no vehicles, no cattle), all, or a list of them.",
    )
    rename: dict[Label, Label] = Field(
        default_factory=lambda: dict(RENAMED), description="Other names for classes, by COCO's name."
    )
    max_boxes: int = Field(50, ge=1, le=1000, description="Most boxes of a frame, best first.")
    threads: int = Field(1, ge=1, le=64, description="Threads of the model.")

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What is wrong with the model file or the labels: see `dssmsg.slot_problems`."""
        from dssmsg.onnx.problems import problems_of

        return problems_of(lambda: CocoDetector(self, base_dir))


class CocoDetector:
    """Boxes of COCO's classes. A frame's answer depends on its image alone."""

    def __init__(self, config: Config, base_dir: Path = Path()) -> None:
        """Opens the model. Raises InputError if it is missing or not the catalogue's, ConfigError for a label
        that it does not know.
        """
        from dssmsg.models.cache import checked_path
        from dssmsg.models.catalogue import known_model
        from dssmsg.onnx.names import noted_names
        from dssmsg.onnx.session import open_model

        given = None if config.model is None else base_dir / Path(config.model).expanduser()
        path = checked_path(known_model(MODEL), given, key=".model")
        self._model = open_model(path, threads=config.threads, key=".model")
        self._config = config
        names = noted_names(self._model) or ()
        self._names = tuple(config.rename.get(name, name) for name in names)
        self._wanted = _wanted(names, self._names, config)

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Sequence[Box]:
        """Boxes, best first; of the classes in `labels` alone where a tagger names some."""
        wanted = self._wanted
        if labels is not None:
            asked = {_plain(label) for label in labels}
            wanted = wanted & np.array([_plain(name) in asked for name in self._names])
        outputs = dict(
            zip(OUTPUTS, self._model.run({"images": model_input(frame.rgb)}, OUTPUTS), strict=True)
        )
        corners, scores, classes, chances = decode(outputs, wanted, self._config.score)
        height, width = frame.depth.shape
        corners = corners * (np.array([width, height, width, height]) / SIDE)
        corners = np.clip(corners, 0.0, [width, height, width, height])
        config = self._config
        kept = nms(corners, scores, classes, config.nms_iou, len(scores))
        kept = kept[nms(corners[kept], scores[kept], np.zeros(len(kept)), config.same_place_iou, len(kept))]
        kept = kept[_not_nested(corners[kept], classes[kept], config.nested)][: config.max_boxes]
        return [
            Box(
                corners[place], self._names[classes[place]], min(1.0, float(scores[place])),
                label_scores=self._considered(chances[place]),
            )
            for place in kept
        ]  # fmt: skip

    def _considered(self, chances: Float32Array) -> tuple[tuple[str, float], ...]:
        """The likeliest of the classes (C,), best first."""
        best = np.argsort(-chances, kind="stable")[:CONSIDERED]
        return tuple(
            (self._names[place], min(1.0, float(chances[place]))) for place in best if chances[place]
        )


def model_input(rgb: ByteArray) -> Float32Array:
    """(1, 3, 416, 416) float32 of an image (H, W, 3): pulled to size, BGR, by COCO's mean and deviation."""
    image = Image.fromarray(rgb).resize((SIDE, SIDE), Image.Resampling.BILINEAR)
    bgr = np.asarray(image, dtype=np.float32)[..., ::-1]
    return ((bgr - MEAN_BGR) / SCALE_BGR).transpose(2, 0, 1)[None]


def decode(
    outputs: Mapping[str, NDArray[Any]], wanted: NDArray[np.bool_], least: float
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], Float32Array]:
    """Boxes (N, 4) xyxy in pixels of the model's input, scores (N,), classes (N,) and all chances (N, C) of
    the wanted classes, before suppression.

    `outputs` are `cls_s` (1, n, C) probabilities and `reg_s` (1, n, 4 * bins), for each stride s, one row a
    cell, row by row. A side's distance from the cell's centre is the expectation of its distribution over
    0 .. bins - 1 strides. Each cell speaks for the class that suits it best among the `wanted` (C,).
    """
    corners, scores, classes, all_chances = [], [], [], []
    for stride in STRIDES:
        chances = np.where(wanted, outputs[f"cls_{stride}"][0], 0.0)
        best = chances.argmax(axis=1)
        cells = np.flatnonzero(chances[np.arange(len(best)), best] > least)
        sides = outputs[f"reg_{stride}"][0][cells].astype(np.float64)
        logits = sides.reshape(len(cells), 4, sides.shape[1] // 4)
        weights = np.exp(logits - logits.max(axis=2, keepdims=True))
        steps = np.arange(logits.shape[2])
        distances = stride * (weights * steps).sum(axis=2) / weights.sum(axis=2)
        rows, columns = np.divmod(cells, SIDE // stride)
        x, y = (columns + 0.5) * stride, (rows + 0.5) * stride
        left, top, right, bottom = distances.T
        corners.append(np.stack([x - left, y - top, x + right, y + bottom], axis=1))
        scores.append(chances[cells, best[cells]].astype(np.float64))
        classes.append(best[cells])
        all_chances.append(chances[cells].astype(np.float32))
    return (
        np.concatenate(corners), np.concatenate(scores), np.concatenate(classes), np.concatenate(all_chances),
    )  # fmt: skip


def _not_nested(corners: FloatArray, classes: NDArray[np.int64], share: float) -> NDArray[np.bool_]:
    """(N,) bool: boxes (N, 4), best first, without those of a class that lie in, or around, a better one.

    The network likes to see a chair's back and the whole chair as two; suppression by IoU lets both pass.
    """
    areas = np.prod(corners[:, 2:] - corners[:, :2], axis=1)
    kept = np.ones(len(corners), dtype=np.bool_)
    for place in range(len(corners)):
        rivals = np.flatnonzero(kept[:place] & (classes[:place] == classes[place]))
        low = np.maximum(corners[rivals, :2], corners[place, :2])
        high = np.minimum(corners[rivals, 2:], corners[place, 2:])
        shared = np.prod(np.clip(high - low, 0.0, None), axis=1)
        kept[place] = not (shared > share * np.minimum(areas[rivals], areas[place])).any()
    return kept


def _wanted(names: Sequence[str], renamed: Sequence[str], config: Config) -> NDArray[np.bool_]:
    """(C,) bool: which classes to report."""
    if config.labels == "all":
        return np.ones(len(names), dtype=np.bool_)
    if config.labels == "indoor":
        return np.array([name not in OUTDOOR for name in names])
    asked = {_plain(label) for label in config.labels}
    known = {_plain(name) for name in (*names, *renamed)}
    if unknown := sorted(asked - known):
        raise ConfigError(
            f"the model does not know {', '.join(unknown)}; it knows {', '.join(sorted(renamed))}",
            key=".labels",
        )
    return np.array([bool(asked & {_plain(a), _plain(b)}) for a, b in zip(names, renamed, strict=True)])


def _plain(name: str) -> str:
    return " ".join(name.replace("_", " ").lower().split())


@hookimpl
def register_detector(register: Register) -> None:
    """`coco`: NanoDet on COCO's classes."""
    register("coco", lambda config, context: CocoDetector(config, context.base_dir), config=Config)
