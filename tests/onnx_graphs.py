"""Tiny ONNX graphs with the inputs and outputs of real exports, and answers that can be worked out by hand.

They look for plain colours: a detector's box is the box around all pixels of a colour, a segmenter's mask is
all that has the colour in the middle of the box, CLIP's space has an axis a colour. So what comes out shows
whether an image was laid into the model, and the answer taken out of it, rightly.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

COLOURS = {"red": (255, 0, 0), "green": (0, 255, 0), "blue": (0, 0, 255)}
SCORES = (0.9, 0.8, 0.7)
IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
FLOAT, HALF, LONG = TensorProto.FLOAT, TensorProto.FLOAT16, TensorProto.INT64


class Graph:
    """Nodes in the order in which they are added; each `add` returns its output's name."""

    def __init__(self) -> None:
        self.nodes, self.constants, self.inputs, self.outputs = [], [], [], []

    def value(self, array) -> str:
        name = f"c{len(self.constants)}"
        array = np.asarray(array)
        array = array.astype(np.float32) if array.dtype == np.float64 else array
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def add(self, op: str, *inputs, **attributes) -> str:
        name = f"n{len(self.nodes)}"
        named = [one if isinstance(one, str) else self.value(one) for one in inputs]
        self.nodes.append(helper.make_node(op, named, [name], **attributes))
        return name

    def input(self, name: str, shape, kind=FLOAT) -> str:
        self.inputs.append(helper.make_tensor_value_info(name, kind, shape))
        if kind == HALF:
            return self.add("Cast", name, to=FLOAT)
        return name

    def output(self, value: str, name: str, shape, kind=FLOAT) -> None:
        if kind == HALF:
            value = self.add("Cast", value, to=HALF)
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, kind, shape))

    def save(self, path: Path, **metadata: str) -> Path:
        graph = helper.make_graph(self.nodes, "tiny", self.inputs, self.outputs, self.constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        helper.set_model_props(model, metadata)
        onnx.checker.check_model(model)
        onnx.save(model, str(path))
        return path

    # What the graphs below are made of

    def reshape(self, value: str, *shape: int) -> str:
        return self.add("Reshape", value, np.array(shape, np.int64))

    def coloured(self, image: str, colour) -> str:
        """(1, 1, H, W): 1 where the image (1, 3, H, W), 0..1, is near a colour."""
        aim = np.array(colour, np.float32).reshape(1, 3, 1, 1) / 255
        distance = self.add(
            "ReduceSum", self.add("Abs", self.add("Sub", image, aim)), np.array([1], np.int64)
        )
        return self.add("Cast", self.add("Less", distance, np.float32([0.75])), to=FLOAT)

    def box(self, mask: str, height: int, width: int) -> str:
        """(1, 4, 1): xyxy around the ones of a mask (1, 1, H, W); meaningless if there are none."""
        x = np.arange(width, dtype=np.float32).reshape(1, 1, 1, width)
        y = np.arange(height, dtype=np.float32).reshape(1, 1, height, 1)
        ends = []
        for ramp, end in ((width - x, width), (height - y, height), (x + 1, 0), (y + 1, 0)):
            most = self.add("ReduceMax", self.add("Mul", mask, ramp), keepdims=0)
            ends.append(self.add("Sub", np.float32([end]), most) if end else self.reshape(most, 1))
        return self.reshape(self.add("Concat", *ends, axis=0), 1, 4, 1)

    def presence(self, mask: str) -> str:
        """(1, 1, 1): 1 if a mask has any."""
        return self.reshape(self.add("ReduceMax", mask, keepdims=0), 1, 1, 1)

    def logit(self, value: str) -> str:
        clipped = self.add("Clip", value, np.float32(0.02), np.float32(0.98))
        return self.add("Log", self.add("Div", clipped, self.add("Sub", np.float32([1.0]), clipped)))

    def colour_boxes(self, image: str, size) -> tuple[list[str], str, str]:
        """Masks, boxes (1, 4, 3) xyxy and presence (1, 3, 1) of the three colours."""
        masks = [self.coloured(image, colour) for colour in COLOURS.values()]
        boxes = self.add("Concat", *[self.box(mask, *size) for mask in masks], axis=2)
        return masks, boxes, self.add("Concat", *[self.presence(mask) for mask in masks], axis=1)

    def centred(self, boxes: str) -> str:
        """xyxy (1, 4, N) as centre, width, height."""
        half = np.float32([[0.5, 0, 0.5, 0], [0, 0.5, 0, 0.5], [-1, 0, 1, 0], [0, -1, 0, 1]])
        return self.add("MatMul", half[None], boxes)


def anchors(height: int, width: int) -> int:
    return sum((height // stride) * (width // stride) for stride in (8, 16, 32))


def yolo(
    path: Path,
    *,
    size=(96, 96),
    names=("red", "green", "blue"),
    channels_last=False,
    logits=False,
    half=False,
    dynamic=False,
    masks=False,
    nms=False,
    ports=("images", "output0", "output1"),
    **metadata: str,
) -> Path:
    """Ultralytics export: raw or with NMS, with masks or without; SCORES where a colour is seen."""
    graph = Graph()
    kind = HALF if half else FLOAT
    shape = ("batch", 3, "height", "width") if dynamic else (1, 3, *size)
    image = graph.input(ports[0], shape, kind)
    found, boxes, seen = graph.colour_boxes(image, size)
    diagonal = np.diag(SCORES).astype(np.float32)[None]
    scores = graph.add("Mul", diagonal, seen)
    weights = np.zeros((1, 32, 3), np.float32)
    weights[0, :3] = np.eye(3)
    if nms:
        best = graph.add("Mul", np.float32(SCORES).reshape(1, 3, 1), seen)
        columns = [
            graph.add("Transpose", boxes, perm=[0, 2, 1]),
            best,
            np.arange(3, dtype=np.float32).reshape(1, 3, 1),
        ]
        columns += [weights.transpose(0, 2, 1)] if masks else []
        table = graph.add("Concat", *columns, axis=2)
        table = graph.add("Pad", table, np.array([0, 0, 0, 0, 297, 0], np.int64))
        outside = (1, 300, 38 if masks else 6)
    else:
        scores = graph.logit(scores) if logits else scores
        rows = [graph.centred(boxes), scores, *([weights] if masks else [])]
        table = graph.add("Concat", *rows, axis=1)
        count = anchors(*size)
        filler = np.zeros((1, 7 + 32 * masks, count - 3), np.float32)
        filler[:, 4:7] = -5.0 if logits else 0.0
        table = graph.add("Concat", table, filler, axis=2)
        outside = (1, 7 + 32 * masks, count)
        if channels_last:
            table = graph.add("Transpose", table, perm=[0, 2, 1])
            outside = (outside[0], outside[2], outside[1])
        if dynamic:
            outside = ("batch", outside[1], "anchors")
    graph.output(table, ports[1], outside, kind)
    if masks:
        small = [graph.add("AveragePool", one, kernel_shape=[4, 4], strides=[4, 4]) for one in found]
        maps = graph.add("Concat", *small, axis=1)
        maps = graph.add("Mul", graph.add("Sub", maps, np.float32([0.5])), np.float32([8.0]))
        maps = graph.add("Pad", maps, np.array([0, 0, 0, 0, 0, 29, 0, 0], np.int64))
        low = ("mask_height", "mask_width") if dynamic else (size[0] // 4, size[1] // 4)
        graph.output(maps, ports[2], ("batch" if dynamic else 1, 32, *low), kind)
    if names is not None:
        metadata["names"] = repr(dict(enumerate(names)))
    return graph.save(path, **metadata)


def fixed_boxes(path: Path, boxes, names, *, size=(96, 96)) -> Path:
    """Ultralytics export that sees the same boxes (xyxy, class, score) in every image."""
    graph = Graph()
    image = graph.input("images", (1, 3, *size))
    table = np.zeros((1, 4 + len(names), anchors(*size)), np.float32)
    for place, (corners, class_id, score) in enumerate(boxes):
        x0, y0, x1, y1 = corners
        table[0, :4, place] = [(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0]
        table[0, 4 + class_id, place] = score
    nothing = graph.add("Mul", graph.add("ReduceMean", image, keepdims=0), np.float32([0.0]))
    graph.output(graph.add("Add", table, nothing), "output0", table.shape)
    return graph.save(path, names=repr(dict(enumerate(names))))


def yolo_text(path: Path, *, size=(96, 96), texts=4, dimension=8, logits=False, dynamic=False) -> Path:
    """YOLO-World with text features: a colour's score is its SCORE times the text's share of its axis."""
    graph = Graph()
    image = graph.input("images", ("batch", 3, "height", "width") if dynamic else (1, 3, *size))
    text = graph.input("txt_feats", ("batch", "texts", dimension) if dynamic else (1, texts, dimension))
    _masks, boxes, seen = graph.colour_boxes(image, size)
    axes = np.zeros((1, dimension, 3), np.float32)
    axes[0, :3] = np.diag(SCORES)
    # An empty text spoils everything, as it would the attention of the real head.
    full = graph.add("Sign", graph.add("ReduceMin", graph.add("ReduceL2", text, axes=[2]), keepdims=0))
    row = graph.add("Mul", graph.add("Transpose", seen, perm=[0, 2, 1]), full)
    scores = graph.add("Mul", graph.add("MatMul", text, axes), row)
    scores = graph.logit(scores) if logits else graph.add("Clip", scores, np.float32(0.0), np.float32(1.0))
    table = graph.add("Concat", graph.centred(boxes), scores, axis=1)
    shape = ("batch", "channels", "anchors") if dynamic else (1, 4 + texts, 3)
    if not dynamic:
        filler = np.zeros((1, 4 + texts, anchors(*size) - 3), np.float32)
        filler[:, 4:] = -5.0 if logits else 0.0
        table, shape = graph.add("Concat", table, filler, axis=2), (1, 4 + texts, anchors(*size))
    graph.output(table, "output0" if dynamic else "output", shape)
    return graph.save(path)


def mmdet(path: Path, *, size=(96, 96), nms=True, padding=False, rows=5) -> Path:
    """AILab-CVC export; with `padding` it has a fourth, nameless class."""
    graph = Graph()
    image = graph.input("images", (1, 3, *size))
    _masks, boxes, seen = graph.colour_boxes(image, size)
    boxes = graph.add("Transpose", boxes, perm=[0, 2, 1])
    if not nms:
        count = anchors(*size)
        scores = graph.add("Mul", np.diag(SCORES).astype(np.float32)[None], seen)
        grown = graph.add("Pad", scores, np.array([0, 0, 0, 0, count - 3, int(padding)], np.int64))
        graph.output(grown, "scores", (1, count, 3 + padding))
        graph.output(
            graph.add("Pad", boxes, np.array([0, 0, 0, 0, count - 3, 0], np.int64)), "boxes", (1, count, 4)
        )
        return graph.save(path)
    scores = graph.add("Mul", np.float32([SCORES]), graph.reshape(seen, 1, 3))
    graph.output(graph.value(np.array([[3]], np.int64)), "num_dets", (1, 1), LONG)
    graph.output(
        graph.add("Pad", boxes, np.array([0, 0, 0, 0, rows - 3, 0], np.int64)), "boxes", (1, rows, 4)
    )
    graph.output(graph.add("Pad", scores, np.array([0, 0, 0, rows - 3], np.int64)), "scores", (1, rows))
    labels = np.array([[0, 1, 3 if padding else 2] + [-1] * (rows - 3)], np.int64)
    graph.output(graph.value(labels), "labels", (1, rows), LONG)
    return graph.save(path)


def feature_maps(path: Path) -> Path:
    """AILab-CVC export with --model-only: three maps that nobody has decoded."""
    graph = Graph()
    image = graph.input("images", (1, 3, 96, 96))
    for number, stride in enumerate((8, 16, 32)):
        pooled = graph.add("AveragePool", image, kernel_shape=[stride] * 2, strides=[stride] * 2)
        graph.output(pooled, f"map{number}", (1, 3, 96 // stride, 96 // stride))
    return graph.save(path)


def plain(graph: Graph, image: str, normal) -> str:
    """Normalised pixels back to 0..1."""
    mean, std = (np.float32(one).reshape(1, 3, 1, 1) for one in normal)
    return graph.add("Add", graph.add("Mul", image, std), mean)


def ram(path: Path, *, flags=True, side=384, extra=1) -> Path:
    """Tags red, green, blue and `extra` more that are never seen; 0 and 1, or logits."""
    graph = Graph()
    image = plain(graph, graph.input("image", (1, 3, side, side)), IMAGENET)
    _masks, _boxes, seen = graph.colour_boxes(image, (side, side))
    seen = graph.reshape(seen, 1, 3)
    if not flags:
        seen = graph.logit(graph.add("Mul", seen, np.float32([SCORES])))
    tags = graph.add("Concat", seen, np.full((1, extra), 0.0 if flags else -4.0, np.float32), axis=1)
    graph.output(tags, "tag", (1, 3 + extra))
    return graph.save(path)


def picture(shapes, *, size=(120, 160), ground=(90, 90, 90)) -> np.ndarray:
    """An image (H, W, 3) uint8 with coloured boxes: colour name and xyxy pixels."""
    image = np.full((*size, 3), ground, np.uint8)
    for colour, (x0, y0, x1, y1) in shapes:
        image[y0:y1, x0:x1] = COLOURS[colour]
    return image
