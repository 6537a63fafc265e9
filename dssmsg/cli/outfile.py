"""The file that a command writes: refused before the work where it must not be, else written whole."""

from __future__ import annotations

from pathlib import Path


def check_output(output: Path | None, *inputs: Path, force: bool, key: str = "--output") -> None:
    """Refuse an output before the work that it would cost.

    Raises ConfigError where it exists (unless `force`), where it is a folder or lies in none, and where it is
    one of the inputs, whatever `force` says: a command never writes what it reads.
    """
    from dssmsg.errors import ConfigError

    if output is None:
        return
    if any(_same(output, one) for one in inputs):
        raise ConfigError("is what is read here; give another file", file=output, key=key)
    if output.is_dir():
        raise ConfigError("is a folder; expected a file", file=output, key=key)
    if output.exists() and not force:
        raise ConfigError("exists already; give --force to overwrite it", file=output, key=key)
    if not output.parent.is_dir():
        raise ConfigError("there is no such folder", file=output.parent, key=key)


def write_output(data: bytes, output: Path | None, *, force: bool) -> None:
    """Write bytes to a file, or to stdout.

    Raises ConfigError if the file exists by now, StorageError if it cannot be written.
    """
    import os
    import sys
    import tempfile

    from dssmsg.errors import StorageError

    if output is None:
        sys.stdout.buffer.write(data)
        return
    check_output(output, force=force)
    try:
        handle, name = tempfile.mkstemp(dir=output.parent, prefix=f".{output.name}-")
        temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            mask = os.umask(0)
            os.umask(mask)
            temporary.chmod(0o666 & ~mask)
            temporary.replace(output)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be written ({error.strerror})", file=output) from error


def _same(output: Path, read: Path) -> bool:
    """Is it the same file, or one of the folder that is read (recordings alone are)?"""
    try:
        if read.is_dir():
            return output.suffix == ".rrd" and read.resolve() in output.resolve().parents
        return output.samefile(read)
    except OSError:  # one of them is not there
        return False
