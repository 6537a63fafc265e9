"""Plug-ins of one's own: files, folders, `package.module:Class` and `path/file.py:Class`."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from dssmsg.config_errors import did_you_mean
from dssmsg.errors import ConfigError, PluginError

PACKAGE = "dssmsg_user"


@dataclass(frozen=True, slots=True)
class PluginFile:
    """A Python file of the user's, by its resolved path."""

    path: Path

    @property
    def module(self) -> str:
        """The name it is imported under."""
        return f"{PACKAGE}.{self.path.stem}"


def find_files(path: Path, base_dir: Path, *, key: str) -> list[PluginFile]:
    """The plug-in files of one `plugins:` entry: the file, or those right in a folder, sorted.

    In a folder, names that start with `_` are left out. Raises ConfigError for what is neither.
    """
    place = (base_dir / path.expanduser()).resolve()
    if place.is_dir():
        return [
            PluginFile(one)
            for one in sorted(place.glob("*.py"))
            if one.is_file() and not one.name.startswith("_")
        ]
    if not place.exists():
        raise ConfigError(f"{place} does not exist; expected a Python file or a folder of them", key=key)
    if place.suffix != ".py" or not place.stem.isidentifier():
        raise ConfigError(
            f"{place}: expected a Python file with a name like my_detector.py, or a folder", key=key
        )
    return [PluginFile(place)]


def import_file(file: PluginFile) -> ModuleType:
    """Run a plug-in file as `dssmsg_user.<stem>`; no folder is put into `sys.path`.

    A module of that name that was loaded before is replaced, and comes back if this file fails. Raises
    whatever the file raises.
    """
    package = sys.modules.get(PACKAGE)
    if package is None:
        package = ModuleType(PACKAGE, "Plug-ins loaded from files.")
        package.__path__ = []
        sys.modules[PACKAGE] = package
    spec = importlib.util.spec_from_file_location(file.module, file.path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file.path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    before = sys.modules.get(file.module)
    sys.modules[file.module] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        if before is None:
            del sys.modules[file.module]
        else:
            sys.modules[file.module] = before
        raise
    setattr(package, file.path.stem, module)
    return module


def locate_class(
    place: str, attribute: str, base_dir: Path, *, kind: str, key: str
) -> tuple[Any, ModuleType, str]:
    """(class, its module, name) of `place:attribute`, where `place` is a module or a `.py` file.

    The name leaves out folders, so that a change log does not depend on where a project lies.
    Raises ConfigError if there is no such file, module or class; PluginError if importing it fails.
    """
    is_file = place.endswith(".py")
    name = f"{Path(place).stem if is_file else place}.{attribute}"
    if is_file:
        path = (base_dir / Path(place).expanduser()).resolve()
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such file", key=key)
        origin = str(path)
    else:
        origin = place
    try:
        module = _loaded(path) if is_file else importlib.import_module(place)
    except ModuleNotFoundError as error:
        if not is_file and error.name and (place == error.name or place.startswith(f"{error.name}.")):
            raise ConfigError(f"there is no module '{error.name}' to import", key=key) from error
        raise _import_failed(error, kind, name, origin, key) from error
    except (Exception, SystemExit) as error:
        raise _import_failed(error, kind, name, origin, key) from error
    found = getattr(module, attribute, None)
    if found is None:
        classes = [
            one for one, value in vars(module).items() if isinstance(value, type) and not one.startswith("_")
        ]
        raise ConfigError(f"{origin} has no class '{attribute}'{did_you_mean(attribute, classes)}", key=key)
    return found, module, name


def _loaded(path: Path) -> ModuleType:
    """The file as a module: once a process, so that two slots naming one file share its classes."""
    file = PluginFile(path)
    known = sys.modules.get(file.module)
    if known is not None and known.__file__ is not None and Path(known.__file__) == path:
        return known
    return import_file(file)


def _import_failed(error: BaseException, kind: str, name: str, origin: str, key: str) -> PluginError:
    if isinstance(error, SyntaxError):
        reason = f"SyntaxError: {error.msg} (line {error.lineno})"
    else:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return PluginError(f"failed to load: {reason}", plugin=f"{kind}/{name}", file=origin, key=key)
