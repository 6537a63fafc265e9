"""Stage `render`: one shard of views a seed, written once, so that the stage can be stopped and resumed."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import InputError
from dssmsg.recogniser.shelf import Shelf, all_labels, seed_range
from dssmsg.recogniser.views import View, home_views, lived_in_views, room_views
from dssmsg.sim.furniture import FurnitureLibrary

VIEWS_A_SEED = 10
KINDS = ("room",) * 11 + ("embedded room",) * 2 + ("home",) * 5 + ("embedded home",) * 2
"""What a seed renders: `KINDS[seed % 20]`. Rooms give variety, homes the look of the scenes."""
CLUTTERED_FROM = 300
"""Seeds from here on give cluttered rooms: small things are rare in the others."""
CLUTTERED = ("cluttered room",) * 17 + ("embedded cluttered room",) * 3
LIVED_IN_FROM = 600
"""From here on rooms and homes as people leave them, mostly seen from near by."""
LIVED_IN = ("lived-in room", "lived-in home", "lived-in room", "lived-in home", "embedded lived-in room",
            "lived-in room", "lived-in home", "lived-in room", "lived-in home", "lived-in room")  # fmt: skip
LIVED_IN_VIEWS = 15


@dataclass(frozen=True, slots=True)
class Shard:
    """The views of one seed: rgb (N, H, W, 3) uint8, depth_mm (N, H, W) uint16, ids (N, H, W) uint8,
    poses (N, 4, 4); label (K,) int: index into `all_labels()` of id k, -1 where an id is not used."""

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]
    ids: NDArray[np.uint8]
    poses: NDArray[np.float64]
    label: NDArray[np.int16]


def render(folder: Path, seeds: Iterable[int], *, part: int = 0, parts: int = 1) -> int:
    """Render the seeds of `part` (of `parts`, for several processes) that have no shard yet; counts them."""
    folder.mkdir(parents=True, exist_ok=True)
    # Opened once each: reading the catalogues takes as long as some rooms.
    shelf_of, library_of = functools.cache(Shelf), functools.cache(FurnitureLibrary.open)
    made = 0
    for seed in seeds:
        path = folder / f"{seed:06d}.npz"
        if seed % parts != part or path.exists():
            continue
        if seed not in seed_range("train"):
            raise ValueError(f"seed {seed} is kept for the evaluation")
        kinds = LIVED_IN if seed >= LIVED_IN_FROM else CLUTTERED if seed >= CLUTTERED_FROM else KINDS
        kind = kinds[seed % len(kinds)]
        assets = "embedded" if kind.startswith("embedded") else "real"
        try:
            if "lived-in" in kind:
                home = library_of(assets) if kind.endswith("home") else None
                views = list(lived_in_views(shelf_of(assets), seed, LIVED_IN_VIEWS, home))
            elif kind.endswith("room"):
                views = list(room_views(shelf_of(assets), seed, VIEWS_A_SEED, clutter="cluttered" in kind))
            else:
                views = list(home_views(library_of(assets), seed, VIEWS_A_SEED))
        except InputError as error:  # a few seeds give no home
            print(f"seed {seed} left out: {error}", flush=True)
            continue
        if views:
            _write(path, views)
            made += 1
        if made % 20 == 0:
            print(f"{made} shards, seed {seed}", flush=True)
    return made


def load(path: Path) -> Shard:
    """A shard from its file."""
    with np.load(path) as data:
        return Shard(data["rgb"], data["depth_mm"], data["ids"], data["poses"], data["label"])


def shards(folder: Path) -> list[Path]:
    """All shards, by seed."""
    return sorted(folder.glob("*.npz"))


def _write(path: Path, views: list[View]) -> None:
    index = {label: i for i, label in enumerate(all_labels())}
    names = dict(chain.from_iterable(view.things.items() for view in views))
    label = np.full(max(names, default=0) + 1, -1, np.int16)
    for number, (name, _model) in names.items():
        label[number] = index[name]
    temporary = path.with_suffix(".part")
    with temporary.open("wb") as file:
        np.savez(
            file,
            rgb=np.stack([view.frame.rgb for view in views]),
            depth_mm=np.stack([np.rint(view.frame.depth * 1000).astype(np.uint16) for view in views]),
            ids=np.stack([view.instance_ids.astype(np.uint8) for view in views]),
            poses=np.stack([view.frame.world_from_camera for view in views]),
            label=label,
        )
    temporary.replace(path)


def frames(folder: Path) -> Iterator[Shard]:
    """All shards in order of their seeds."""
    return (load(path) for path in shards(folder))
