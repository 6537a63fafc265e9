"""Segmenters of the SAM family: an image is embedded once, every box then asks for its mask.

Four layouts: Meta's (SAM, MobileSAM) with preprocessing inside or outside the encoder, EfficientSAM in two
files or one, and that of transformers.js, which takes points only.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import ConfigError, InputError
from dssmsg.frame import ByteArray, Float32Array, FloatArray, MaskArray
from dssmsg.onnx.letterbox import Fit, lay_in, planes
from dssmsg.onnx.masks import image_mask
from dssmsg.onnx.matching import Binding

USUAL_SIZE = 1024
CELL = 16
"""Pixels of the encoder's input a cell of its embedding."""
IMAGENET_MEAN = (123.675 / 255, 116.28 / 255, 103.53 / 255)
IMAGENET_STD = (58.395 / 255, 57.12 / 255, 57.375 / 255)
FOREGROUND, BOX_FIRST, BOX_LAST = 1, 2, 3

ENCODERS = (
    "sam-encoder",
    "sam-encoder-image",
    "efficient-sam-encoder",
    "transformers-sam-encoder",
    "efficient-sam",
)
DECODER_OF = {
    "sam-encoder": "sam-decoder",
    "sam-encoder-image": "sam-decoder",
    "efficient-sam-encoder": "efficient-sam-decoder",
    "transformers-sam-encoder": "transformers-sam-decoder",
}
WHOLE = "efficient-sam"


class Sam(Protocol):
    """A segmenter file, or pair of files, at work."""

    def masks(self, rgb: ByteArray, boxes: FloatArray, points: FloatArray) -> list[MaskArray]:
        """One mask (H, W) bool a box of an image (H, W, 3) uint8.

        boxes (N, 4) xyxy pixels; points (N, K, 2) x, y pixels that lie on the things, the surest first, for
        models that take no boxes. ValueError: the model gives other shapes than its contract says.
        """
        ...


def make_sam(encoder: Binding, decoder: Binding | None) -> Sam:
    """The segmenter of an encoder file and its decoder file; tried on a grey image once.

    Raises ConfigError if the two do not belong together, InputError if they cannot be run.
    """
    sam: Sam
    if encoder.contract.name == WHOLE or encoder.contract.name == "efficient-sam-encoder":
        sam = EfficientSam(encoder, decoder)
    elif decoder is None:
        raise ConfigError("is missing", file=encoder.model.path, key=".decoder")
    elif encoder.contract.name == "transformers-sam-encoder":
        sam = TransformersSam(encoder, decoder)
    else:
        sam = MetaSam(encoder, decoder)
    grey = np.full((48, 64, 3), 114, dtype=np.uint8)
    file = encoder.model.path if decoder is None else decoder.model.path
    try:
        sam.masks(grey, np.array([[16.0, 12.0, 48.0, 36.0]]), np.array([[[32.0, 24.0]]]))
    except (RuntimeError, ValueError) as error:
        key = ".encoder" if decoder is None else ".decoder"
        raise InputError(f"cannot be used: tried on a grey image, {error}", file=file, key=key) from error
    return sam


def check_pair(encoder: Binding, decoder: Binding) -> None:
    """Raise ConfigError where the sizes of the embedding that both files fix differ."""
    for role in ("embedding", "positions"):
        if role not in encoder or role not in decoder:
            continue
        gives, takes = encoder.ports[role], decoder.ports[role]
        for axis in range(4):
            one, other = gives.size(axis), takes.size(axis)
            if one is not None and other is not None and one != other:
                raise ConfigError(
                    f"takes an embedding {takes}, the encoder {encoder.model.path.name} gives {gives}; "
                    "take encoder and decoder of one model",
                    file=decoder.model.path,
                    key=".decoder",
                )


class MetaSam:
    """SAM and MobileSAM in the layout of Meta's `SamOnnxModel`: one decoder call a box."""

    def __init__(self, encoder: Binding, decoder: Binding) -> None:
        self._encoder, self._decoder = encoder, decoder
        self._raw = encoder.contract.name == "sam-encoder-image"
        cells = encoder.sizes.get("h")
        self._side = encoder.sizes.get("S", USUAL_SIZE if cells is None else cells * CELL)
        self._mask_side = decoder.ports["mask"].size(2) or self._side // 4
        # With a fixed number of points only the corners of a box and one filler can be asked for.
        points = decoder.ports["points"].size(1)
        self._fillers = 1 if points is None else points - 2
        if self._fillers < 0:
            raise ConfigError(
                f"takes {points} point, a box has two corners; export it with a dynamic number of points",
                file=decoder.model.path,
                key=".decoder",
            )

    def masks(self, rgb: ByteArray, boxes: FloatArray, points: FloatArray) -> list[MaskArray]:
        """See `Sam`."""
        image, fit = lay_in(rgb, (self._side, self._side), "corner", pad=0)
        embedding = self._embed(image, fit)
        return [self._mask(embedding, fit, box) for box in boxes]

    def _embed(self, image: ByteArray, fit: Fit) -> Float32Array:
        inner = image[: int(fit.inner_size[0]), : int(fit.inner_size[1])]
        if self._raw:
            pixels = inner.astype(np.float32)
        else:
            # The rim is filled after the colours are normalised: it is zero for the model.
            pixels = np.zeros((1, 3, *fit.input_size), dtype=np.float32)
            pixels[:, :, : inner.shape[0], : inner.shape[1]] = planes(inner, IMAGENET_MEAN, IMAGENET_STD)
        encoder = self._encoder
        (embedding,) = encoder.model.run({encoder.name("image"): pixels}, [encoder.name("embedding")])
        return embedding

    def _mask(self, embedding: Float32Array, fit: Fit, box: FloatArray) -> MaskArray:
        decoder = self._decoder
        corners = fit.to_input(box).reshape(2, 2)
        fillers = np.zeros((self._fillers, 2))
        labels = [BOX_FIRST, BOX_LAST] + [-1] * self._fillers
        feeds: dict[str, NDArray[Any]] = {
            decoder.name("embedding"): embedding,
            decoder.name("points"): np.concatenate([corners, fillers])[None],
            decoder.name("labels"): np.array([labels], dtype=np.float32),
            decoder.name("mask"): np.zeros((1, 1, self._mask_side, self._mask_side), dtype=np.float32),
            decoder.name("has_mask"): np.zeros(1, dtype=np.float32),
            decoder.name("size"): np.array(fit.image_size, dtype=np.float32),
        }
        # `masks` is cut with a size that tracing froze in some exports; the small masks never are.
        names = [decoder.name("low_masks"), decoder.name("quality")]
        low, quality = decoder.model.run(feeds, names)
        if low.ndim != 4 or quality.shape != low.shape[:2]:
            raise ValueError(
                f"expected masks (1, M, h, w) and M qualities, got {low.shape} and {quality.shape}"
            )
        # Of four, the first is for prompts that leave no doubt, such as a box; the others are its parts.
        best = 0 if low.shape[1] in (1, 4) else int(np.argmax(quality[0]))
        return image_mask(low[0, best], fit)


class EfficientSam:
    """EfficientSAM, in two files or one: many boxes a call, where the graph leaves that open."""

    def __init__(self, encoder: Binding, decoder: Binding | None) -> None:
        self._encoder = encoder
        self._decoder = encoder if decoder is None else decoder
        if decoder is None and encoder.contract.name != WHOLE:
            raise ConfigError("is missing", file=encoder.model.path, key=".decoder")
        self._queries = self._decoder.ports["points"].size(1)
        points = self._decoder.ports["points"].size(2)
        # The official export freezes one point a query: then the middle has to do.
        self._points = 2 if points is None else points
        height, width = encoder.sizes.get("H"), encoder.sizes.get("W")
        self._size = None if height is None or width is None else (height, width)

    def masks(self, rgb: ByteArray, boxes: FloatArray, points: FloatArray) -> list[MaskArray]:
        """See `Sam`."""
        image, fit = lay_in(rgb, self._size or rgb.shape[:2], "corner", pad=0)
        feeds: dict[str, NDArray[Any]] = {}
        pixels = planes(image)
        encoder, decoder = self._encoder, self._decoder
        if decoder is encoder:
            feeds[encoder.name("image")] = pixels
        else:
            (embedding,) = encoder.model.run({encoder.name("image"): pixels}, [encoder.name("embedding")])
            feeds[decoder.name("embedding")] = embedding
            feeds[decoder.name("size")] = np.array(fit.input_size, dtype=np.int64)
        coordinates, labels = self._prompts(fit, boxes, points)
        step = self._queries or max(1, len(boxes))
        found: list[MaskArray] = []
        for start in range(0, len(boxes), step):
            some = slice(start, start + step)
            found += self._ask(feeds, coordinates[some], labels, fit, step)
        return found

    def _prompts(self, fit: Fit, boxes: FloatArray, points: FloatArray) -> tuple[FloatArray, list[int]]:
        """Prompts (N, P, 2) in input pixels and their P kinds."""
        if self._points == 1:
            return fit.to_input(points[:, :1]), [FOREGROUND]
        corners = fit.to_input(boxes).reshape(-1, 2, 2)
        fillers = np.repeat(corners[:, :1], self._points - 2, axis=1)
        return np.concatenate([corners, fillers], axis=1), [BOX_FIRST, BOX_LAST] + [-1] * (self._points - 2)

    def _ask(
        self, feeds: dict[str, NDArray[Any]], prompts: FloatArray, labels: list[int], fit: Fit, step: int
    ) -> list[MaskArray]:
        decoder = self._decoder
        count = len(prompts)
        padded = np.concatenate([prompts, np.repeat(prompts[:1], step - count, axis=0)])
        feeds = {
            **feeds,
            decoder.name("points"): padded[None],
            decoder.name("labels"): np.tile(np.array(labels, dtype=np.float32), (1, len(padded), 1)),
        }
        masks, quality = decoder.model.run(feeds, [decoder.name("masks"), decoder.name("quality")])
        return [_best_mask(masks, quality, place, fit) for place in range(count)]


class TransformersSam:
    """SAM in the layout of transformers.js: it takes points, boxes are silently ignored there."""

    def __init__(self, encoder: Binding, decoder: Binding) -> None:
        self._encoder, self._decoder = encoder, decoder
        self._side = encoder.sizes.get("S", USUAL_SIZE)
        self._queries = decoder.ports["points"].size(1)
        self._points = decoder.ports["points"].size(2)

    def masks(self, rgb: ByteArray, boxes: FloatArray, points: FloatArray) -> list[MaskArray]:
        """See `Sam`."""
        image, fit = lay_in(rgb, (self._side, self._side), "corner", pad=0)
        pixels = np.zeros((1, 3, *fit.input_size), dtype=np.float32)
        height, width = int(fit.inner_size[0]), int(fit.inner_size[1])
        pixels[:, :, :height, :width] = planes(image[:height, :width], IMAGENET_MEAN, IMAGENET_STD)
        encoder, decoder = self._encoder, self._decoder
        embedding, positions = encoder.model.run(
            {encoder.name("image"): pixels}, [encoder.name("embedding"), encoder.name("positions")]
        )
        count = self._points or points.shape[1]
        chosen = points[:, np.minimum(np.arange(count), points.shape[1] - 1)]
        prompts = fit.to_input(chosen)
        step = self._queries or max(1, len(boxes))
        found: list[MaskArray] = []
        for start in range(0, len(boxes), step):
            some = prompts[start : start + step]
            padded = np.concatenate([some, np.repeat(some[:1], step - len(some), axis=0)])
            feeds: dict[str, NDArray[Any]] = {
                decoder.name("embedding"): embedding,
                decoder.name("positions"): positions,
                decoder.name("points"): padded[None],
                decoder.name("labels"): np.full((1, len(padded), count), FOREGROUND, dtype=np.int64),
            }
            masks, quality = decoder.model.run(feeds, [decoder.name("masks"), decoder.name("quality")])
            found += [_best_mask(masks, quality, place, fit) for place in range(len(some))]
        return found


def _best_mask(masks: NDArray[Any], quality: NDArray[Any], place: int, fit: Fit) -> MaskArray:
    """The mask of a query that the model itself thinks best."""
    if masks.ndim != 5 or quality.shape != masks.shape[:3] or place >= masks.shape[1]:
        raise ValueError(
            f"expected masks (1, Q, M, h, w) and qualities (1, Q, M), got {masks.shape} and {quality.shape}"
        )
    return image_mask(masks[0, place, int(np.argmax(quality[0, place]))], fit)
