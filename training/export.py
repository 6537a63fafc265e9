"""Stage `export`: checkpoints to ONNX, the calibration of the scores, and the card that names it all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from dssmsg.evaluate.perception import MIN_IOU, mask_iou, visible
from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, CROP_SIDE
from dssmsg.recogniser.grouping import GroupingRule, vote
from dssmsg.recogniser.inputs import GEOMETRY_CHANNELS, geometry_channels, half_geometry, normalised_rgb
from dssmsg.recogniser.networks import CARD, MaskNetwork, read_card, softmax
from dssmsg.recogniser.recogniser import Recogniser
from dssmsg.recogniser.shelf import Shelf, all_labels
from dssmsg.recogniser.views import View, home_views, lived_in_views, room_views
from dssmsg.sim.furniture import FurnitureLibrary
from training.nets import CropNet, MaskNet

CALIBRATION_SEEDS = range(90_000, 90_012)
LIVED_IN_SEEDS = range(90_100, 90_108)
"""Rooms of the training range that no other stage renders; the second ones as people leave them."""
_LARGE, _HALF_MAX = 256, 60_000.0
TIGHT_IOU = 0.65
"""A score is the chance of a right name and of a mask this good: a map suffers from masks that leak."""


def export(masks: Path, crops: Path, folder: Path) -> None:
    """Write `masks.onnx`, `crops.onnx` and a card without calibration into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    mask_net = MaskNet(len(all_labels()), GEOMETRY_CHANNELS)
    mask_net.load_state_dict(torch.load(masks, weights_only=True)["net"])
    _to_onnx(
        mask_net, (torch.zeros(1, 3, 240, 320), torch.zeros(1, GEOMETRY_CHANNELS, 120, 160)),
        folder / "masks.onnx", ["rgb", "geometry"], ["dense", "classes"],
        {"rgb": {2: "H", 3: "W"}, "geometry": {2: "h", 3: "w"}},
    )  # fmt: skip
    crop_net = CropNet(len(all_labels()), CROP_EXTRA, CROP_FACTS)
    crop_net.load_state_dict(torch.load(crops, weights_only=True)["net"])
    _to_onnx(
        crop_net, (torch.zeros(2, 3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE), torch.zeros(2, CROP_FACTS)),
        folder / "crops.onnx", ["crops", "facts"], ["vectors", "logits"],
        {name: {0: "N"} for name in ("crops", "facts", "vectors", "logits")},
    )  # fmt: skip
    write_card(folder)


def _to_onnx(
    net: nn.Module,
    example: tuple[Tensor, ...],
    path: Path,
    inputs: Sequence[str],
    outputs: Sequence[str],
    axes: dict[str, dict[int, str]],
) -> None:
    net.eval()
    torch.onnx.export(
        net, example, str(path), input_names=list(inputs), output_names=list(outputs), dynamic_axes=axes,
        opset_version=17, dynamo=False,
    )  # fmt: skip
    _store_half(path)


def _store_half(path: Path) -> None:
    """Keep large weights as 16-bit floats, cast back when the network is loaded: half the file."""
    model = onnx.load(path)
    casts, kept = [], []
    for weight in model.graph.initializer:
        values = onnx.numpy_helper.to_array(weight)
        if values.dtype != np.float32 or values.size < _LARGE or np.abs(values).max() > _HALF_MAX:
            kept.append(weight)
            continue
        stored = f"{weight.name}.half"
        kept.append(onnx.numpy_helper.from_array(values.astype(np.float16), stored))
        casts.append(onnx.helper.make_node("Cast", [stored], [weight.name], to=onnx.TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.extend(kept)
    model.graph.node.extend(nodes)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def write_card(
    folder: Path,
    temperature: float = 1.0,
    context: float = 0.5,
    joining: Sequence[float] = (),
    quality: Sequence[float] = (1.0, 1.0, 0.0, 0.0, 0.0),
) -> None:
    """The card beside the networks: labels, sums, calibration."""
    sums = {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
        for name in ("masks.onnx", "crops.onnx")
    }
    card = {
        "labels": list(all_labels()),
        "sha256": sums,
        "temperature": round(temperature, 4),
        "context": round(context, 4),
        "joining": [round(float(value), 4) for value in joining],
        "quality": [round(float(value), 4) for value in quality],
    }
    (folder / CARD).write_text(json.dumps(card, indent=1) + "\n", "utf-8")


def calibrate(folder: Path, views_a_seed: int = 12) -> None:
    """Fit the card's numbers on CALIBRATION_SEEDS: labels, then joining, then the score; rewrite it."""
    write_card(folder)
    views = list(_calibration_views(views_a_seed))
    temperature, context = _fit_labels(folder, views)
    joining = _fit_joining(folder, views)
    write_card(folder, temperature, context, joining)
    recogniser = Recogniser(folder, max_crops=40)
    rows, right = [], []
    for view in views:
        counted = visible(view)
        for seen in recogniser.consider(view.frame)[2]:
            number = int(np.argmax(np.bincount(view.instance_ids[seen.mask])))
            found = number > 0 and mask_iou(seen.mask, view.instance_ids == number) >= MIN_IOU
            if found and number not in counted:
                continue
            tight = number > 0 and mask_iou(seen.mask, view.instance_ids == number) >= TIGHT_IOU
            label = recogniser.labels[int(np.argmax(seen.probabilities[:-1]))]
            rows.append(seen.evidence)
            right.append(tight and label == view.things[number][0])
    quality = logistic(np.array(rows), np.array(right, np.float64))
    write_card(folder, temperature, context, joining, quality)
    print(f"temperature {temperature:.2f}, context {context:.2f}, right {np.mean(right):.3f} of {len(right)}")


def _fit_joining(folder: Path, views: Sequence[View]) -> NDArray[np.float64]:
    """Weights of the logistic that says whether two touching pieces are one thing."""
    card, place = read_card(folder)
    network = MaskNetwork(place, card, 1)
    rows: list[NDArray[np.float32]] = []
    one: list[bool] = []
    for view in views:
        frame = view.frame
        geometry = half_geometry(frame.depth, frame.camera, frame.world_from_camera, 0.0)
        maps = network.run(normalised_rgb(frame.rgb), geometry_channels(geometry))
        pieces = vote(*maps, geometry, GroupingRule())
        ids = view.instance_ids[::2, ::2]
        owners = [_owner(ids[pieces.numbers == n + 1]) for n in range(len(pieces.peaks))]
        found = pieces.contacts
        for first, second, facts in zip(found.first, found.second, found.facts, strict=True):
            if owners[first - 1] is not None and owners[second - 1] is not None:
                rows.append(facts)
                one.append(owners[first - 1] == owners[second - 1] != 0)
    return logistic(np.array(rows), np.array(one, np.float64))


def _owner(ids: NDArray[np.int32]) -> int | None:
    """The instance that most of a piece belongs to; None for a piece that is a mixture."""
    if len(ids) == 0:
        return None
    counts = np.bincount(ids)
    return int(np.argmax(counts)) if counts.max() > 0.6 * len(ids) else None


def _calibration_views(count: int) -> list[View]:
    shelf, library = Shelf("real"), FurnitureLibrary.open("real")
    views: list[View] = []
    for seed in CALIBRATION_SEEDS:
        views += home_views(library, seed, count) if seed % 2 else room_views(shelf, seed, count)
    for seed in LIVED_IN_SEEDS:
        views += lived_in_views(shelf, seed, count, library if seed % 2 else None)
    return views


def _fit_labels(folder: Path, views: Sequence[View]) -> tuple[float, float]:
    """(temperature, context) with the least negative log-likelihood of true labels on true masks."""
    recogniser = Recogniser(folder)
    logits, contexts, truth = [], [], []
    for view in views:
        counted = visible(view)
        if counted:
            _, logit, context = recogniser.opinions(view.frame, [view.instance_ids == n for n in counted])
            logits.append(logit)
            contexts.append(context)
            truth += [recogniser.labels.index(view.things[number][0]) for number in counted]
    logit, context = np.concatenate(logits), np.log(np.concatenate(contexts) + 1e-6)
    best = (np.inf, 1.0, 0.0)
    for weight in (0.0, 0.15, 0.3, 0.5, 0.75, 1.0):
        for temperature in (0.5, 0.7, 0.85, 1.0, 1.2, 1.5):
            crop = np.log(softmax(logit, temperature) + 1e-6)
            joint = softmax((crop + np.float32(weight) * context).astype(np.float32))
            cost = -float(np.log(joint[np.arange(len(truth)), truth] + 1e-6).mean())
            best = min(best, (cost, temperature, weight))
    return best[1], best[2]


def logistic(rows: NDArray[np.float32], right: NDArray[np.float64], steps: int = 50) -> NDArray[np.float64]:
    """Weights of a logistic regression with a little ridge, by Newton's method."""
    x = rows.astype(np.float64)
    weight = np.zeros(x.shape[1])
    for _ in range(steps):
        p = 1 / (1 + np.exp(-np.clip(x @ weight, -30, 30)))
        slope = x.T @ (p - right) + 1.0 * weight
        bend = (x * (p * (1 - p))[:, None]).T @ x + 1.0 * np.eye(x.shape[1])
        weight -= np.linalg.solve(bend, slope)
    return weight
