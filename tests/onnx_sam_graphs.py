"""Tiny graphs of the SAM family: a mask is all that has the colour in the middle of the box."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from onnx_graphs import FLOAT, LONG, Graph, plain

SAM = ((123.675 / 255, 116.28 / 255, 103.53 / 255), (58.395 / 255, 57.12 / 255, 57.375 / 255))


def _embed(graph: Graph, image: str, channels: int) -> str:
    """(1, channels, 64, 64): mean colours of cells, the other channels zero."""
    pooled = graph.add("AveragePool", image, kernel_shape=[16, 16], strides=[16, 16])
    return graph.add("Pad", pooled, np.array([0, 0, 0, 0, 0, channels - 3, 0, 0], np.int64))


def _same_colour(graph: Graph, embedding: str, cells: str, count) -> str:
    """(Q, 1, 64, 64) logits, above 0 where a cell has the colour of the query's; cells (Q, 2) x, y int64."""
    colours = graph.add("Slice", embedding, np.array([0]), np.array([3]), np.array([1]))
    last = graph.add("Transpose", graph.add("Squeeze", colours, np.array([0])), perm=[1, 2, 0])
    swapped = graph.add("Gather", cells, np.array([1, 0]), axis=1)
    wanted = graph.reshape(graph.add("GatherND", last, swapped), count, 3, 1, 1)
    distance = graph.add("Abs", graph.add("Sub", colours, wanted))
    return graph.add("Sub", np.float32([0.75]), graph.add("ReduceSum", distance, np.array([1], np.int64)))


def _cells(graph: Graph, points: str, scale) -> str:
    """Cells (N, 2) int64 of points (N, 2) x, y."""
    scaled = graph.add("Mul", points, scale)
    return graph.add(
        "Cast", graph.add("Clip", graph.add("Floor", scaled), np.float32(0), np.float32(63)), to=LONG
    )


def sam_encoder(path: Path, *, inside=False, channels=256, name="input_image") -> Path:
    """Meta's image encoder; `inside`: it takes (H, W, 3) 0..255 and pads itself."""
    graph = Graph()
    if inside:
        raw = graph.input(name, ("image_height", "image_width", 3))
        scaled = graph.add("Unsqueeze", graph.add("Transpose", raw, perm=[2, 0, 1]), np.array([0]))
        scaled = graph.add("Div", scaled, np.float32([255.0]))
        shape = graph.add("Shape", scaled)
        rim = graph.add("Sub", np.array([1, 3, 1024, 1024], np.int64), shape)
        image = graph.add("Pad", scaled, graph.add("Concat", np.zeros(4, np.int64), rim, axis=0))
    else:
        image = plain(graph, graph.input(name, (1, 3, 1024, 1024)), SAM)
    graph.output(_embed(graph, image, channels), "image_embeddings", (1, channels, 64, 64))
    return graph.save(path)


def sam_decoder(path: Path, *, masks=4, channels=256, points=None) -> Path:
    """Meta's decoder; of its masks the first is right, or with three masks the second."""
    graph = Graph()
    embedding = graph.input("image_embeddings", (1, channels, 64, 64))
    prompts = graph.input("point_coords", (1, points or "num_points", 2))
    labels = graph.input("point_labels", (1, points or "num_points"))
    graph.input("mask_input", (1, 1, 256, 256))
    graph.input("has_mask_input", (1,))
    size = graph.input("orig_im_size", (2,))
    corners = graph.add("Slice", prompts, np.array([0]), np.array([2]), np.array([1]))
    middle = graph.add("ReduceMean", corners, axes=[1], keepdims=0)
    right = _same_colour(graph, embedding, _cells(graph, middle, np.float32([1 / 16])), 1)
    # Wrong kinds of points make every mask empty.
    kinds = graph.add("Slice", labels, np.array([0]), np.array([2]), np.array([1]))
    off = graph.add("ReduceSum", graph.add("Abs", graph.add("Sub", kinds, np.float32([[2, 3]]))), keepdims=1)
    right = graph.add("Sub", right, graph.reshape(graph.add("Mul", off, np.float32([100.0])), 1, 1, 1, 1))
    right = graph.add("Resize", right, "", np.float32([1, 1, 4, 4]), mode="nearest")
    wrong = graph.add("Sub", graph.add("Mul", right, np.float32([0.0])), np.float32([1.0]))
    order = [right] if masks == 1 else [wrong, right, wrong] if masks == 3 else [right, wrong, wrong, wrong]
    low = graph.add("Concat", *order, axis=1)
    quality = {1: [0.5], 3: [0.2, 0.9, 0.4], 4: [0.5, 0.9, 0.8, 0.1]}[masks]
    extent = graph.add("Concat", np.array([1, masks], np.int64), graph.add("Cast", size, to=LONG), axis=0)
    full = graph.add("Resize", low, "", "", extent, mode="linear")
    graph.output(full, "masks", (1, masks, "height", "width"))
    graph.output(graph.value(np.float32([quality])), "iou_predictions", (1, masks))
    graph.output(low, "low_res_masks", (1, masks, 256, 256))
    return graph.save(path)


def _efficient_masks(graph: Graph, embedding: str, points: str, labels: str, size: str, box: bool) -> str:
    """(1, Q, 3, H, W): the second mask is right."""
    middle = graph.reshape(graph.add("ReduceMean", points, axes=[2], keepdims=0), -1, 2)
    width_first = graph.add("Gather", graph.add("Cast", size, to=FLOAT), np.array([1, 0]), axis=0)
    cells = _cells(graph, middle, graph.add("Div", np.float32([64.0]), width_first))
    right = _same_colour(graph, embedding, cells, -1)
    kinds = graph.add("ReduceSum", graph.add("Abs", labels), np.array([2], np.int64), keepdims=0)
    off = graph.add("Abs", graph.add("Sub", kinds, np.float32([5.0 if box else 1.0])))
    right = graph.add("Sub", right, graph.reshape(graph.add("Mul", off, np.float32([100.0])), -1, 1, 1, 1))
    wrong = graph.add("Sub", graph.add("Mul", right, np.float32([0.0])), np.float32([1.0]))
    three = graph.add("Concat", wrong, right, wrong, axis=1)
    count = graph.add("Slice", graph.add("Shape", three), np.array([0]), np.array([2]))
    grown = graph.add("Resize", three, "", "", graph.add("Concat", count, size, axis=0), mode="linear")
    return graph.add("Unsqueeze", grown, np.array([0]))


def _efficient_prompts(graph: Graph, queries, points) -> tuple[str, str]:
    where = graph.input("batched_point_coords", (1, queries, points, 2))
    return where, graph.input("batched_point_labels", (1, queries, points))


def _efficient_outputs(graph: Graph, masks: str, queries) -> None:
    graph.output(masks, "output_masks", (1, queries, 3, "height", "width"))
    shape = graph.add("Slice", graph.add("Shape", masks), np.array([0]), np.array([2]))
    even = graph.add(
        "Expand", np.float32([[[0.2, 0.9, 0.4]]]), graph.add("Concat", shape, np.array([3]), axis=0)
    )
    graph.output(even, "iou_predictions", (1, queries, 3))


def _efficient_embed(graph: Graph, image: str) -> str:
    small = graph.add("Resize", image, "", "", np.array([1, 3, 64, 64], np.int64), mode="nearest")
    return graph.add("Pad", small, np.array([0, 0, 0, 0, 0, 253, 0, 0], np.int64))


def efficient_encoder(path: Path, *, size=("height", "width")) -> Path:
    graph = Graph()
    image = graph.input("batched_images", (1, 3, *size))
    graph.output(_efficient_embed(graph, image), "image_embeddings", (1, 256, 64, 64))
    return graph.save(path)


def efficient_decoder(path: Path, *, queries="num_queries", points=2) -> Path:
    """EfficientSAM's decoder; `points` 1 freezes one point a query, as the official script does."""
    graph = Graph()
    embedding = graph.input("image_embeddings", (1, 256, 64, 64))
    prompts = _efficient_prompts(graph, queries, points)
    size = graph.input("orig_im_size", (2,), LONG)
    _efficient_outputs(graph, _efficient_masks(graph, embedding, *prompts, size, points != 1), queries)
    return graph.save(path)


def efficient_whole(path: Path) -> Path:
    graph = Graph()
    image = graph.input("batched_images", (1, 3, "height", "width"))
    prompts = _efficient_prompts(graph, "num_queries", "num_points")
    size = graph.add("Slice", graph.add("Shape", image), np.array([2]), np.array([4]))
    embedding = _efficient_embed(graph, image)
    _efficient_outputs(graph, _efficient_masks(graph, embedding, *prompts, size, True), "num_queries")
    return graph.save(path)


def transformers_encoder(path: Path) -> Path:
    graph = Graph()
    image = plain(graph, graph.input("pixel_values", ("batch_size", 3, 1024, 1024)), SAM)
    graph.output(_embed(graph, image, 256), "image_embeddings", (1, 256, 64, 64))
    graph.output(
        graph.value(np.full((1, 256, 64, 64), 0.5, np.float32)),
        "image_positional_embeddings",
        (1, 256, 64, 64),
    )
    return graph.save(path)


def transformers_decoder(path: Path, *, points="nb_points") -> Path:
    """Takes points; a query's first one says which colour, the labels must all be 1."""
    graph = Graph()
    embedding = graph.input("image_embeddings", (1, 256, 64, 64))
    positions = graph.input("image_positional_embeddings", (1, 256, 64, 64))
    where = graph.input("input_points", ("batch_size", "point_batch_size", points, 2))
    labels = graph.input("input_labels", ("batch_size", "point_batch_size", points), LONG)
    first = graph.add("Slice", where, np.array([0]), np.array([1]), np.array([2]))
    right = _same_colour(
        graph, embedding, _cells(graph, graph.reshape(first, -1, 2), np.float32([1 / 16])), -1
    )
    odd = graph.add("Abs", graph.add("Sub", graph.add("Cast", labels, to=FLOAT), np.float32([1.0])))
    off = graph.add(
        "Add",
        graph.add("ReduceSum", odd, keepdims=0),
        graph.add("Sub", graph.add("ReduceMean", positions, keepdims=0), np.float32([0.5])),
    )
    right = graph.add("Sub", right, graph.add("Mul", off, np.float32([100.0])))
    right = graph.add("Resize", right, "", np.float32([1, 1, 4, 4]), mode="nearest")
    wrong = graph.add("Sub", graph.add("Mul", right, np.float32([0.0])), np.float32([1.0]))
    masks = graph.add("Unsqueeze", graph.add("Concat", wrong, right, wrong, axis=1), np.array([0]))
    shape = graph.add("Slice", graph.add("Shape", masks), np.array([0]), np.array([2]))
    even = graph.add(
        "Expand", np.float32([[[0.2, 0.9, 0.4]]]), graph.add("Concat", shape, np.array([3]), axis=0)
    )
    graph.output(even, "iou_scores", ("batch_size", "point_batch_size", 3))
    graph.output(masks, "pred_masks", ("batch_size", "point_batch_size", 3, 256, 256))
    return graph.save(path)
