"""Stage `masks`: trains the dense network; checkpoints, so that it can be stopped and resumed."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from dssmsg.recogniser.inputs import GEOMETRY_CHANNELS
from dssmsg.recogniser.shelf import all_labels
from training.nets import MaskNet
from training.render import LIVED_IN_FROM
from training.samples import Views


@dataclass(frozen=True, slots=True)
class Plan:
    """How long and how fast to learn.

    The learning rate's course is laid out for `steps`, training ends after `until`; the shards of seeds below
    `seeds` are used; `small` gives the pixels of small things more weight, 0 = each pixel counts the same,
    and with `everywhere` also in what is learnt of centres and borders. `lived_in` is the share of the views
    that show rooms as people leave them, None: as many as there are.
    """

    steps: int = 1100
    until: int = 800
    batch: int = 8
    rate: float = 2e-3
    seed: int = 0
    save_every: int = 100
    seeds: int = 360
    small: float = 0.0
    everywhere: bool = False
    lived_in: float | None = None


def loss(
    dense: Tensor, classes: Tensor, target: list[Tensor], nothing: int, plan: Plan
) -> tuple[Tensor, list[float]]:
    """The weighted sum of the five losses, and each of them."""
    thing, heat, border, offset, weight, label = target
    bce = functional.binary_cross_entropy_with_logits
    even = 1 + plan.small * weight  # the weight is 0 outside things, and grows as things get small
    coarse = even[:, ::2, ::2]
    shape = even if plan.everywhere else torch.ones_like(even)
    named = torch.where(label < 0, nothing, label).long()
    parts = [
        bce(dense[:, 0], thing, weight=even),
        60 * ((torch.sigmoid(dense[:, 1]) - heat).square() * (0.3 + heat) * shape).mean(),
        2 * ((dense[:, 2:4] - offset).abs().sum(1) * weight).sum() / weight.sum().clamp(min=1),
        0.5 * bce(dense[:, 4], border, weight=shape, pos_weight=torch.tensor(3.0)),
        0.5 * (functional.cross_entropy(classes, named, reduction="none") * coarse).mean(),
    ]
    return torch.stack(parts).sum(), [float(part.detach()) for part in parts]


_EVERY_SHARD = Plan(steps=900, until=900, rate=1.6e-3, seed=1, seeds=LIVED_IN_FROM, small=1.0)
_LIVED_IN = Plan(
    steps=600, until=600, rate=1e-3, seed=3, seeds=10**6, small=1.5, everywhere=True, lived_in=0.6
)
ROUNDS = (
    Plan(),
    _EVERY_SHARD,
    replace(_EVERY_SHARD, steps=600, until=500, rate=1.2e-3, seed=2),
    _LIVED_IN,
    replace(_LIVED_IN, steps=2000, until=2000, rate=1.2e-3, seed=4),
    replace(_LIVED_IN, steps=2000, until=2000, rate=1.2e-3, seed=5, lived_in=0.7),
)
"""The rounds, each going on with the network of the one before: whole views of the first seeds; every shard,
with more weight on small things; the same from a lower rate; mostly rooms full of small things, which count
in every part of the loss; that for longer, from a higher rate again; once more, with more of such rooms."""


def train(folder: Path, out: Path, plan: Plan, begin_with: Path | None = None) -> None:
    """Train to `out` (a checkpoint), going on from it where it is there. Prints a line every 20 steps.

    `begin_with`: a checkpoint whose network is taken over at first.
    """
    views = Views(folder, plan.seeds)
    torch.manual_seed(plan.seed)
    nothing = len(all_labels())
    net = MaskNet(nothing, GEOMETRY_CHANNELS)
    net.backbone.load_imagenet()
    net.to(memory_format=torch.channels_last)
    pretrained = list(net.backbone.parameters())
    known = {id(parameter) for parameter in pretrained}
    fresh = [parameter for parameter in net.parameters() if id(parameter) not in known]
    optimiser = torch.optim.AdamW(
        [{"params": fresh, "lr": plan.rate}, {"params": pretrained, "lr": plan.rate / 3}], weight_decay=0.01
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [plan.rate, plan.rate / 3], total_steps=plan.steps, pct_start=0.1
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
    chance = None if plan.lived_in is None else _chances(views, plan.lived_in)
    net.train()
    began, sums = time.time(), np.zeros(5)
    for step in range(start, plan.until):
        rng = np.random.default_rng([plan.seed, step])
        drawn = rng.choice(len(views), plan.batch, replace=False, p=chance)
        samples = [views.sample(int(i), rng) for i in drawn]
        image, geometry, *target = (torch.from_numpy(np.stack(part)) for part in zip(*samples, strict=True))
        dense, classes = net(
            *(part.contiguous(memory_format=torch.channels_last) for part in (image, geometry))
        )
        total, parts = loss(dense, classes, target, nothing, plan)
        optimiser.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        schedule.step()
        sums += parts
        if (step + 1) % 20 == 0:
            text = " ".join(f"{value:.3f}" for value in sums / 20)
            print(f"{step + 1} {text} {(time.time() - began) / (step + 1 - start):.2f} s/step", flush=True)
            sums[:] = 0
        if (step + 1) % plan.save_every == 0 or step + 1 == plan.until:
            torch.save(
                {"net": net.state_dict(), "optimiser": optimiser.state_dict(),
                 "schedule": schedule.state_dict(), "step": step + 1}, out,
            )  # fmt: skip


def _chances(views: Views, lived_in: float) -> NDArray[np.float64]:
    """(N,) chance of each view, so that those of lived-in rooms have the share `lived_in` of all."""
    late = views.seeds >= LIVED_IN_FROM
    chance: NDArray[np.float64] = np.where(late, lived_in / late.sum(), (1 - lived_in) / (~late).sum())
    return chance / chance.sum()
