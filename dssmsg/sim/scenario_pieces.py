"""What a generated script is written with: other changes for a scene, twins, things that may come."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.scene import Appear, Change, Piece, Placement, Relocate, Scene

_SCREEN = (0.6, 0.4, 1.25)
_NEW = (
    "backpack", "potted plant", "vase", "bottle", "bowl", "laptop", "kettle", "teapot", "box", "teddy bear",
    "basket", "radio", "suitcase", "handbag", "stool", "candle", "flowers", "clothes", "ball", "toaster",
    "fan",
)  # fmt: skip


def plain_scene(scene: Scene) -> Scene:
    """The scene without its own script; queries that ask for what only the script brings go with it."""
    kept = {piece.id for piece in scene.furniture}
    queries = tuple(query for query in scene.queries if set(query.targets) <= kept)
    return Scene.model_validate({**dict(scene), "changes": (), "queries": queries})


def scripted(scene: Scene, changes: Sequence[Change]) -> Scene:
    """The scene with these changes instead of its own."""
    return Scene.model_validate({**dict(scene), "changes": tuple(changes)})


def with_twins(
    scene: Scene, library: FurnitureLibrary, rng: np.random.Generator, wanted: int
) -> tuple[Scene, list[tuple[str, str]]]:
    """The scene with pairs of one category that differ in model and colour, and the pairs.

    Nothing else tells the swap of two things of one kind; so one of them becomes another model of the same
    category, at the size that it had.
    """
    loaded = {piece.on for piece in scene.furniture}
    by_category: dict[str, list[Piece]] = {}
    for piece in scene.furniture:
        model = library.model(piece.category, model=piece.model, size=piece.size)
        movable = model.movable if piece.movable is None else piece.movable
        if movable and piece.id not in loaded and len(library.models(piece.category)) > 1:
            by_category.setdefault(piece.category, []).append(piece)
    categories = [name for name, pieces in by_category.items() if len(pieces) > 1]
    changed: dict[str, Piece] = {}
    pairs = []
    for index in rng.permutation(len(categories)):
        pieces = by_category[categories[int(index)]]
        order = rng.permutation(len(pieces))
        first, second = pieces[int(order[0])], pieces[int(order[1])]
        models = library.models(first.category)
        own = first.model or models[0]
        other = str(rng.choice([name for name in models if name != own]))
        size = library.model(first.category, model=first.model, size=first.size).size
        changed[second.id] = second.model_copy(update={"model": other, "size": size})
        pairs.append((first.id, second.id))
        if len(pairs) >= 3 * wanted:
            break
    furniture = tuple(changed.get(piece.id, piece) for piece in scene.furniture)
    return Scene.model_validate({**dict(scene), "furniture": furniture}), pairs


def new_pieces(scene: Scene, rng: np.random.Generator) -> list[Piece]:
    """Things that may appear, in random order, with free ids."""
    names = [_NEW[int(i)] for i in rng.permutation(len(_NEW))]
    at = anywhere(scene).at
    return [Piece(id=_free_id(scene, name, 1), category=name, at=at, z=0.0) for name in names]


def screens(scene: Scene, count: int) -> list[Piece]:
    """Tall boxes that hide what is behind them; the first free number of a box is left to a new one."""
    at = anywhere(scene).at
    return [
        Piece(id=_free_id(scene, "box", 2 + i), category="box", size=_SCREEN, at=at, z=0.0)
        for i in range(count)
    ]


def is_screen(piece: Piece) -> bool:
    """Whether a piece is one of `screens`."""
    return piece.size == _SCREEN


def _free_id(scene: Scene, category: str, step: int) -> str:
    stem = category.replace(" ", "_")
    numbers = [int(p.id.rpartition("-")[2]) for p in scene.pieces() if p.id.rpartition("-")[0] == stem]
    return f"{stem}-{max(numbers, default=0) + step}"


def anywhere(scene: Scene) -> Placement:
    """A place to write down where none is known yet."""
    return Placement(at=scene.rooms[0].center, z=0.0)


def appear_change(piece: Piece, at: Placement, visit: int, tag: str = "") -> Appear:
    """`piece` coming in at a place before a visit."""
    placed = Piece.model_validate({**dict(piece), **dict(at)})
    return Appear(kind="appear", piece=placed, before_visit=visit, tag=tag)


def relocate_change(name: str, to: Placement, visit: int, tag: str) -> Relocate:
    """A piece put somewhere else before a visit."""
    return Relocate(kind="relocate", object=name, to=to, before_visit=visit, tag=tag)
