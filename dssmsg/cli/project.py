"""`dssmsg init`: the files to start from."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from dssmsg.errors import StorageError

TEMPLATES = ("dssmsg.yaml", "my_detector.py")


def write_project(directory: Path) -> None:
    """Write the templates into `directory`, which is made on use, and print their paths.

    Raises StorageError, before anything is written, if one of them is already there.
    """
    for name in TEMPLATES:
        if (directory / name).exists():
            raise StorageError("is already there; nothing was written", file=directory / name)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name in TEMPLATES:
            text = (resources.files("dssmsg") / "data" / "templates" / name).read_text(encoding="utf-8")
            with (directory / name).open("x", encoding="utf-8") as stream:
                stream.write(text)
            print(directory / name)
    except OSError as error:
        raise StorageError(
            f"cannot be written: {error.strerror or error}", file=error.filename or directory
        ) from error
