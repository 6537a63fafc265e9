"""What the recogniser is trained on and tested with: furniture models by label, known and held out."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from dssmsg.config_yaml import parse_yaml
from dssmsg.errors import ConfigError, InputError
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.furniture.cache import MeshCache
from dssmsg.sim.furniture.catalogue import Entry, cache_key, convert, read_catalogue
from dssmsg.sim.furniture.categories import load_categories
from dssmsg.sim.furniture.library import furniture_folders
from dssmsg.sim.mesh import Mesh

TABLE = "data/weights/models.yaml"


@dataclass(frozen=True, slots=True)
class ShelfModel:
    """One furniture model: size (x, y, z) and elevation in metres; `common` if scenes take it by default.

    `category` is empty for a model that no scene knows.
    """

    label: str
    model: str
    category: str
    size: tuple[float, float, float]
    elevation: float
    movable: bool
    held_out: bool
    common: bool


@functools.cache
def load_table() -> Mapping[str, Any]:
    """`extra`, `ambiguous`, `held_out` and `seeds` of the packaged table."""
    text = resources.files("dssmsg").joinpath(TABLE).read_text("utf-8")
    table: Mapping[str, Any] = parse_yaml(text, file=TABLE)
    return table


def seed_range(name: str) -> range:
    """The room seeds of `train`, `evaluation` or `unseen_models`."""
    first, end = load_table()["seeds"][name]
    return range(int(first), int(end))


class Shelf:
    """All usable models of one kind of furniture, `real` or `embedded`, in a fixed order."""

    def __init__(self, kind: str = "real") -> None:
        """Raises ConfigError when real furniture is asked for and not installed."""
        self._library = FurnitureLibrary.open(kind)
        self._cache = MeshCache()
        self._entries = _entries() if kind == "real" else {}
        self._meshes: dict[str, Mesh | None] = {}
        self.models: tuple[ShelfModel, ...] = tuple(self._collect())

    @property
    def labels(self) -> tuple[str, ...]:
        """Every label, sorted, each once."""
        return tuple(sorted({model.label for model in self.models}))

    def mesh(self, model: ShelfModel) -> Mesh | None:
        """The mesh in the object frame at its own size, or None for a file that cannot be read."""
        if model.category:
            return self._library.model(model.category, model.model).mesh
        if model.model not in self._meshes:
            self._meshes[model.model] = self._extra_mesh(self._entries[model.model])
        return self._meshes[model.model]

    def _extra_mesh(self, entry: Entry) -> Mesh | None:
        key = cache_key(entry)
        mesh = self._cache.load(key)
        if mesh is None:
            try:
                mesh = convert(entry)
            except InputError:
                return None
            self._cache.store(key, mesh)
        return mesh

    def _collect(self) -> list[ShelfModel]:
        table = load_table()
        held_out = frozenset(table["held_out"])
        found = []
        for name, category in sorted(load_categories().items()):
            hidden = table["ambiguous"].get(name, ())
            for place, piece in enumerate(category.pieces):
                if piece.model in hidden:
                    continue
                out = self._library.kind == "real" and piece.model in held_out
                size = (piece.size[0], piece.size[1], piece.size[2])
                found.append(
                    ShelfModel(category.label, piece.model, name, size, piece.elevation, category.movable,
                               out, place == 0)
                )  # fmt: skip
        for label, models in sorted(table["extra"].items()):
            for model in models:
                entry = self._entries.get(model)
                if entry is not None:
                    found.append(
                        ShelfModel(
                            label, model, "", entry.size, entry.elevation, False, model in held_out, False
                        )
                    )
        return found


def all_labels() -> tuple[str, ...]:
    """Every label of the two tables, sorted: what the recogniser's classifier can say."""
    own = {category.label for category in load_categories().values()}
    return tuple(sorted(own | set(load_table()["extra"])))


def _entries() -> dict[str, Entry]:
    """Entries of the first folder that has furniture libraries."""
    for folder in furniture_folders():
        entries: dict[str, Entry] = {}
        for archive in sorted(folder.glob("*.sh3f")) if folder.is_dir() else ():
            entries |= read_catalogue(archive)
        if entries:
            return entries
    raise ConfigError("no furniture libraries (.sh3f) were found", key="source.assets")
