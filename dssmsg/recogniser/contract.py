"""What training and use must agree on, in one place: sizes, scales and orders of the networks' tensors."""

from __future__ import annotations

OFFSET_PX = 32.0
"""A predicted offset of 1 is this many pixels of the half-size image."""
CROP_SIDE = 96
"""Pixels of a crop's side as the crop encoder sees it."""
CROP_MARGIN = 0.18
"""Share of the mask's longer side that is added around it."""
CROP_EXTRA = 3
"""Channels beside colour: mask, height above the floor, depth relative to the mask's median."""
CROP_FACTS = 16
"""Numbers beside the crop, see `crops.facts`."""
VECTOR = 384
"""Dimension of the text space (`all-minilm-l6-v2/384`)."""
