"""The furniture library: real pieces where they are installed, primitives of the same size where not."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from dssmsg.errors import ConfigError, InputError
from dssmsg.sim.furniture.cache import MeshCache, cache_folder
from dssmsg.sim.furniture.catalogue import Entry, cache_key, convert, read_catalogue
from dssmsg.sim.furniture.categories import Category, Piece, canonical, load_categories
from dssmsg.sim.furniture.embedded import build
from dssmsg.sim.furniture.model import FurnitureModel
from dssmsg.sim.mesh import Mesh

ASSETS = ("auto", "real", "embedded")
VARIABLE = "DSSMSG_FURNITURE"
SYSTEM_FOLDER = Path("/usr/share/sweethome3d/furniture")
PACKAGE = "sweethome3d-furniture"


def furniture_folders() -> tuple[Path, ...]:
    """Where `.sh3f` libraries are looked for, the first wins: $DSSMSG_FURNITURE, the system, the user cache.

    The cache is searched as `dpkg-deb -x` leaves it too, with the package's own folders inside.
    """
    named = os.environ.get(VARIABLE)
    if named:
        return (Path(named),)
    own = cache_folder() / "furniture"
    return (SYSTEM_FOLDER, own, own / SYSTEM_FOLDER.relative_to("/"))


class FurnitureLibrary:
    """Furniture by category. `kind` is `real` or `embedded`; `note` says in one line what was taken and why.

    Both kinds know the same categories, models and sizes, so a scene does not change its layout with them. A
    category without real models (mirrors, dishwashers) is made of primitives in both.
    """

    def __init__(
        self, kind: str, note: str, entries: Mapping[str, Entry], cache: MeshCache | None = None
    ) -> None:
        self.kind = kind
        self.note = note
        self._entries = entries
        self._cache = MeshCache() if cache is None else cache
        self._meshes: dict[str, Mesh] = {}
        self._flawed: list[str] = []

    @classmethod
    def open(cls, assets: str = "auto", *, cache: MeshCache | None = None) -> FurnitureLibrary:
        """The library for `assets`: auto, real or embedded.

        Raises ConfigError (key source.assets) for another word, or when `real` is not installed.
        """
        if assets not in ASSETS:
            raise ConfigError(
                f"unknown assets {assets!r}; accepted: {', '.join(ASSETS)}", key="source.assets"
            )
        if assets == "embedded":
            return cls("embedded", "embedded furniture, as configured", {}, cache)
        entries, folder, problem = _find_entries()
        if entries:
            return cls("real", f"real furniture, {len(entries)} models from {folder}", entries, cache)
        hint = f"install the Debian package {PACKAGE}, or set {VARIABLE} to a folder of .sh3f files"
        if assets == "real":
            raise ConfigError(f"no real furniture: {problem}; {hint}", key="source.assets")
        return cls("embedded", f"embedded furniture: {problem}; for real furniture {hint}", {}, cache)

    @property
    def flawed(self) -> Sequence[str]:
        """Real models asked for so far that could not be read and stand as primitives."""
        return tuple(self._flawed)

    def categories(self) -> tuple[str, ...]:
        """Names of all categories, sorted; the same for both kinds."""
        return tuple(sorted(load_categories()))

    def models(self, category: str) -> tuple[str, ...]:
        """Model names of `category`, the default first. Raises ConfigError for an unknown category."""
        return tuple(piece.model for piece in self._category(category).pieces)

    def model(
        self, category: str, model: str | None = None, size: Sequence[float] | None = None
    ) -> FurnitureModel:
        """A piece of furniture, by default the category's first model at its catalogue size.

        `size` (x, y) or (x, y, z) metres stretches it; without z the height stays. Raises ConfigError for an
        unknown category or model, or a size that is not positive.
        """
        row = self._category(category)
        piece = self._piece(row, model)
        extent = piece.size
        if size is not None:
            numbers = tuple(float(x) for x in size)
            if len(numbers) not in (2, 3) or not all(0 < x < 100 for x in numbers):
                raise ConfigError(
                    f"size of {category!r}: expected 2 or 3 lengths in metres, got {list(size)}", key="size"
                )
            extent = (numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else extent[2])
        mesh, credit = self._mesh(row, piece)
        if any(abs(a - b) > 1e-6 for a, b in zip(extent, piece.size, strict=True)):
            mesh = mesh.scaled_to(extent)
        return FurnitureModel(
            row.name, piece.model, mesh, extent, row.label, credit, row.movable, piece.elevation
        )

    def credits(self, used: Iterable[FurnitureModel]) -> tuple[str, ...]:
        """One line for each author's model among `used`, sorted, each once."""
        return tuple(sorted({model.credit for model in used if model.credit}))

    def _category(self, category: str) -> Category:
        table = load_categories()
        row = table.get(canonical(category))
        if row is None:
            near = difflib.get_close_matches(canonical(category), table, n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(sorted(table))}"
            raise ConfigError(f"unknown furniture category {category!r}; {hint}", key="category")
        return row

    def _piece(self, row: Category, model: str | None) -> Piece:
        for piece in row.pieces:
            if model is None or piece.model == model:
                return piece
        known = ", ".join(piece.model for piece in row.pieces)
        raise ConfigError(f"unknown model {model!r} of {row.name!r}; accepted: {known}", key="model")

    def _mesh(self, row: Category, piece: Piece) -> tuple[Mesh, str | None]:
        """The piece's mesh at its table size, and the credit where it is somebody's work."""
        entry = self._entries.get(piece.model) if row.real else None
        if entry is not None and piece.model not in self._flawed:
            try:
                return self._real_mesh(entry, piece), entry.credit
            except InputError:
                self._flawed.append(piece.model)
        key = f"{row.name}:{piece.model}"
        if key not in self._meshes:
            self._meshes[key] = build(row.parts, piece.size, piece.color, row.name)
        return self._meshes[key], None

    def _real_mesh(self, entry: Entry, piece: Piece) -> Mesh:
        if entry.model not in self._meshes:
            key = cache_key(entry)
            mesh = self._cache.load(key)
            if mesh is None:
                mesh = convert(entry)
                self._cache.store(key, mesh)
            # Another release of the library may have another size; the table's keeps scenes as they are.
            if any(abs(a - b) > 1e-3 for a, b in zip(entry.size, piece.size, strict=True)):
                mesh = mesh.scaled_to(piece.size)
            self._meshes[entry.model] = mesh
        return self._meshes[entry.model]


def _find_entries() -> tuple[dict[str, Entry], Path | None, str]:
    """Entries of the first folder that has libraries, that folder, and else why there are none."""
    problem = ""
    for folder in furniture_folders():
        archives = sorted(folder.glob("*.sh3f")) if folder.is_dir() else []
        entries: dict[str, Entry] = {}
        for archive in archives:
            try:
                entries |= read_catalogue(archive)
            except InputError as error:
                problem = str(error)
        if entries:
            return entries, folder, ""
    where = " or ".join(str(folder) for folder in furniture_folders())
    return {}, None, problem or f"no .sh3f file in {where}"
