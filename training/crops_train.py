"""Stage `crops`: trains the crop encoder towards the labels' text vectors; checkpoints."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from dssmsg.frame import Float32Array
from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, VECTOR
from dssmsg.recogniser.shelf import all_labels
from training.crops import Crops
from training.nets import CropNet


@dataclass(frozen=True, slots=True)
class Plan:
    """How long and how fast to learn."""

    steps: int = 1300
    batch: int = 40
    rate: float = 2e-3
    seed: int = 0
    save_every: int = 100
    vector_weight: float = 2.0
    wild: float = 0.0


TUNING = Plan(steps=1500, rate=1e-3, seed=2, wild=0.25)
"""The second round, in which half of the crops are the mask network's own."""


def label_vectors() -> Float32Array:
    """(C, VECTOR) unit text vectors of all labels, as the default encoder gives them."""
    from dssmsg_plugins.encoder.minilm import MinilmConfig, MinilmEncoder

    return MinilmEncoder(MinilmConfig()).encode_labels(all_labels())


def train(
    folder: Path, out: Path, plan: Plan, *, begin_with: Path | None = None, proposals: Path | None = None
) -> None:
    """Train to `out` (a checkpoint), going on from it where it is there. Prints a line every 20 steps.

    `begin_with`: a checkpoint whose network is taken over at first; `proposals`: see `Crops`.
    """
    crops = Crops(folder, proposals, plan.wild)
    torch.manual_seed(plan.seed)
    labels = len(all_labels())
    net = CropNet(labels, CROP_EXTRA, CROP_FACTS, VECTOR)
    net.backbone.load_imagenet()
    net.to(memory_format=torch.channels_last)
    pretrained = list(net.backbone.parameters())
    known = {id(parameter) for parameter in pretrained}
    fresh = [parameter for parameter in net.parameters() if id(parameter) not in known]
    optimiser = torch.optim.AdamW(
        [{"params": fresh, "lr": plan.rate}, {"params": pretrained, "lr": plan.rate / 2}], weight_decay=0.02
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [plan.rate, plan.rate / 2], total_steps=plan.steps, pct_start=0.1
    )
    start = 0
    if begin_with is not None:
        net.load_state_dict(torch.load(begin_with, weights_only=True)["net"])
    if out.exists():
        saved = torch.load(out, weights_only=True)
        net.load_state_dict(saved["net"])
        optimiser.load_state_dict(saved["optimiser"])
        schedule.load_state_dict(saved["schedule"])
        start = saved["step"]
    # The last row stands for "no thing": no text vector, so its weight below is 0.
    text = torch.from_numpy(np.vstack([label_vectors(), np.zeros((1, VECTOR), np.float32)]))
    net.train()
    began, sums = time.time(), np.zeros(3)
    for step in range(start, plan.steps):
        rng = np.random.default_rng([plan.seed, step, 7])
        image, facts, label = (torch.from_numpy(part) for part in crops.batch(plan.batch, rng))
        vector, logits = net(image.contiguous(memory_format=torch.channels_last), facts)
        named = (label < labels).float()
        away = ((1 - (vector * text[label]).sum(1)) * named).sum() / named.sum().clamp(min=1)
        entropy = functional.cross_entropy(logits, label, label_smoothing=0.05)
        optimiser.zero_grad()
        (entropy + plan.vector_weight * away).backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        schedule.step()
        sums += [
            float(entropy.detach()),
            float(away.detach()),
            float((logits.argmax(1) == label).float().mean()),
        ]
        if (step + 1) % 20 == 0:
            line = " ".join(f"{value:.3f}" for value in sums / 20)
            print(f"{step + 1} {line} {(time.time() - began) / (step + 1 - start):.2f} s/step", flush=True)
            sums[:] = 0
        if (step + 1) % plan.save_every == 0 or step + 1 == plan.steps:
            torch.save(
                {"net": net.state_dict(), "optimiser": optimiser.state_dict(),
                 "schedule": schedule.state_dict(), "step": step + 1}, out,
            )  # fmt: skip
