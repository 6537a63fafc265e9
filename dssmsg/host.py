"""Finds, loads and builds plug-ins. It imports none by name; there is no module-level manager.

    host = Host.load(config.plugins, config.base_dir)
    built = host.build("perception", config.perception, contexts)

Stock plug-ins are entry points of the group `dssmsg`, one a module, loaded one at a time and guarded; then
come the files and folders of `plugins:`. What fails to load is a `Problem`: it is listed, and it ends a run
only if the run wants that plug-in.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pluggy

from dssmsg import hookspecs
from dssmsg.config import RunConfig, Slot, kind_of
from dssmsg.config_errors import choices, did_you_mean, validate
from dssmsg.config_yaml import describe
from dssmsg.errors import ConfigError, DssmsgError, PluginError
from dssmsg.hookspecs import Factory, PluginConfig
from dssmsg.host_files import PluginFile, find_files, import_file, locate_class
from dssmsg.host_protocol import mismatch
from dssmsg.interfaces import KINDS, Context

GROUP = "dssmsg"


@dataclass(frozen=True, slots=True)
class Registration:
    """A plug-in that can be built. `origin` is the path or the entry point it came from."""

    kind: str
    name: str
    factory: Factory
    config: type[PluginConfig]
    needs_truth: bool
    origin: str
    version: str

    @property
    def id(self) -> str:
        """`kind/name`, as causes and errors spell it."""
        return f"{self.kind}/{self.name}"


@dataclass(frozen=True, slots=True)
class Problem:
    """What could not be loaded; `kind` and `name` where they can be told, `clash` if a name is taken."""

    origin: str
    message: str
    kind: str = ""
    name: str = ""
    version: str = ""
    clash: bool = False


@dataclass(frozen=True, slots=True)
class Built:
    """A plug-in at work, and what it was made from."""

    plugin: Any
    registration: Registration
    config: PluginConfig


class Host:
    """What is registered, what failed, and how to build from a slot."""

    def __init__(self) -> None:
        self._registered: dict[tuple[str, str], Registration] = {}
        self._problems: list[Problem] = []
        self._paths: list[str] = []
        self._left: dict[str, list[importlib.metadata.EntryPoint]] = {}
        """Entry points that are not imported yet, by the kind that they are named after."""
        self._manager = pluggy.PluginManager(hookspecs.PROJECT)
        self._manager.add_hookspecs(hookspecs)

    @classmethod
    def load(
        cls,
        plugin_paths: Sequence[str | Path] = (),
        base_dir: Path | None = None,
        *,
        entry_points: Iterable[importlib.metadata.EntryPoint] | None = None,
        kinds: Collection[str] = KINDS,
    ) -> Host:
        """A host with the installed plug-ins and those of `plugin_paths` (relative to `base_dir`).

        `entry_points` None means those of this environment; one that is named after a kind that is not among
        `kinds` is imported once its kind is asked for, for importing all takes half a second. Raises
        ConfigError for a path that is not there; everything else that goes wrong is in `problems`.
        """
        host = cls()
        found = importlib.metadata.entry_points(group=GROUP) if entry_points is None else entry_points
        for entry_point in sorted(found, key=lambda one: (one.name, one.value)):
            host._left.setdefault(_kind_of(entry_point), []).append(entry_point)
        for kind in ("", *kinds):
            host._load_kind(kind)
        loaded: set[Path] = set()
        for index, path in enumerate(plugin_paths):
            for file in find_files(Path(path), base_dir or Path.cwd(), key=f"plugins[{index}]"):
                if file.path not in loaded:
                    loaded.add(file.path)
                    host._load_file(file)
        return host

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What could not be loaded, in the order in which it was tried."""
        return tuple(self._problems)

    @property
    def paths(self) -> tuple[str, ...]:
        """Every file that a plug-in was loaded from."""
        return tuple(self._paths)

    def registrations(self, kind: str | None = None) -> tuple[Registration, ...]:
        """What is registered, sorted by kind (in the order of `KINDS`) and name."""
        for one in KINDS if kind is None else (kind,):
            self._load_kind(one)
        order = {one: place for place, one in enumerate(KINDS)}
        return tuple(
            sorted(
                (one for one in self._registered.values() if kind in (None, one.kind)),
                key=lambda one: (order[one.kind], one.name),
            )
        )

    def check(self, config: RunConfig) -> dict[str, Registration]:
        """Resolve every slot of a configuration; the registration by the slot's dotted key.

        Raises ConfigError or PluginError with key and file: nothing has been built or written yet.
        """
        with config.naming_files():
            self.refuse_clashes()
            return {
                key: self.resolve(kind_of(key), slot, config.base_dir, key)[0]
                for key, slot in config.slots.items()
            }

    def refuse_clashes(self) -> None:
        """Raise ConfigError if two plug-ins claim one name: whichever won, somebody would be surprised."""
        for problem in self._problems:
            if problem.clash:
                raise ConfigError(problem.message, file=problem.origin, key="plugins")

    def resolved(self, config: RunConfig) -> dict[str, Any]:
        """The configuration as plain values with every option of every plug-in, defaults included."""
        values = config.resolved()
        with config.naming_files():
            full = {
                key: {"use": slot.use}
                | self.resolve(kind_of(key), slot, config.base_dir, key)[1].model_dump(mode="json")
                for key, slot in config.slots.items()
            }
        for key, flat in full.items():
            if key.startswith("recording.observers."):
                values["recording"]["observers"][key.removeprefix("recording.observers.")] = flat
            elif key.startswith("diagnosis["):
                values["diagnosis"][int(key[len("diagnosis[") : -1])] = flat
            else:
                values[key] = flat
        return values

    def resolve(
        self, kind: str, slot: Slot | Mapping[str, Any], base_dir: Path | None = None, key: str | None = None
    ) -> tuple[Registration, PluginConfig]:
        """The plug-in a slot names and its validated options; `key` is the slot's place for errors.

        `use: path/file.py:Class` starts from `base_dir`. Raises ConfigError for an unknown name or a wrong
        option, PluginError for a plug-in that failed to load.
        """
        key = key or kind
        self._load_kind(kind)
        use, options = _parts(slot, key)
        if ":" in use:
            registration = self._from_class(kind, use, base_dir or Path.cwd(), key)
        else:
            registration = self._by_name(kind, use, key)
        options_model: PluginConfig = validate(registration.config, options, key=key)
        return registration, options_model

    def build(
        self,
        kind: str,
        slot: Slot | Mapping[str, Any],
        context: Callable[[Registration], Context],
        *,
        base_dir: Path | None = None,
        key: str | None = None,
    ) -> Built:
        """The plug-in of a slot, built with `context(registration)` and held against its Protocol.

        Raises what `resolve` raises, and PluginError where the factory fails or its result does not fit.
        """
        key = key or kind
        registration, options = self.resolve(kind, slot, base_dir, key)
        surroundings = context(registration)
        try:
            plugin = registration.factory(options, surroundings)
        except DssmsgError as error:
            if error.key is None:
                error.key = key
            elif error.key.startswith("."):  # an option of this plug-in, which cannot know its own place
                error.key = key + error.key
            raise
        except ModuleNotFoundError as error:
            raise PluginError(
                f"needs the Python module '{error.name}', which is not installed; install it with pip",
                plugin=registration.id,
                key=key,
            ) from error
        except (Exception, SystemExit) as error:
            raise PluginError(
                f"could not be built: {describe_error(error)}", plugin=registration.id, key=key
            ) from error
        wrong = mismatch(plugin, kind)
        if wrong:
            raise PluginError(wrong, plugin=registration.id, file=registration.origin, key=key)
        return Built(plugin, registration, options)

    # Loading

    def _load_kind(self, kind: str) -> None:
        for entry_point in self._left.pop(kind, ()):
            self._load_entry_point(entry_point, kind)

    def _load_entry_point(self, entry_point: importlib.metadata.EntryPoint, kind: str) -> None:
        distribution = entry_point.dist
        package = distribution.name if distribution is not None else "unknown package"
        version = distribution.version if distribution is not None else ""
        origin = f"{package}: {entry_point.value}"
        name = entry_point.name.removeprefix(f"{kind}.")
        try:
            module = entry_point.load()
        except (Exception, SystemExit) as error:
            self._problems.append(
                Problem(origin, f"failed to load: {describe_error(error)}", kind, name, version)
            )
            return
        self._paths.append(str(getattr(module, "__file__", None) or entry_point.value))
        self._register(module, origin, version, kind, name)

    def _load_file(self, file: PluginFile) -> None:
        try:
            module = import_file(file)
        except (Exception, SystemExit) as error:
            self._problems.append(Problem(str(file.path), f"failed to load: {describe_error(error)}"))
            return
        self._paths.append(str(file.path))
        self._register(module, str(file.path), "")

    def _register(self, plugin: Any, origin: str, version: str, kind: str = "", name: str = "") -> None:
        """Ask one plug-in for its registrations: all of them count, or none."""

        def problem(message: str) -> None:
            self._problems.append(Problem(origin, message, kind, name, version))

        try:
            self._manager.register(plugin, name=origin)
            self._manager.check_pending()
        except (pluggy.PluginValidationError, ValueError) as error:
            # pluggy keeps a plug-in that it found wrong.
            if self._manager.has_plugin(origin):
                self._manager.unregister(name=origin)
            problem(_hook_fault(plugin, error))
            return
        callers = self._manager.get_hookcallers(plugin) or []
        if not callers:
            problem(
                "registers nothing: mark a function register_<kind>(register) with @hookimpl "
                "from dssmsg.hookspecs"
            )
        others = [one for one in self._manager.get_plugins() if one is not plugin]
        taken: list[Registration] = []
        for caller in callers:
            collect = _collector(caller.name.removeprefix("register_"), origin, version, taken)
            try:
                self._manager.subset_hook_caller(caller.name, others)(register=collect)
            except (Exception, SystemExit) as error:
                problem(f"{caller.name}: {describe_error(error)}")
                return
        for one in taken:
            self._add(one)

    def _add(self, new: Registration) -> None:
        old = self._registered.get((new.kind, new.name))
        if old is None:
            self._registered[new.kind, new.name] = new
            return
        self._problems.append(
            Problem(
                new.origin,
                f"{new.kind} '{new.name}' is already registered by {old.origin}; choose another name",
                new.kind,
                new.name,
                new.version,
                clash=True,
            )
        )

    # Resolving

    def _by_name(self, kind: str, name: str, key: str) -> Registration:
        found = self._registered.get((kind, name))
        if found is not None:
            return found
        for problem in self._problems:
            if (problem.kind, problem.name) == (kind, name):
                raise PluginError(
                    f"{problem.message} ({problem.origin})", plugin=f"{kind}/{name}", key=f"{key}.use"
                )
        unknown = [one for one in self._problems if not one.name]
        if unknown:
            # Nobody can tell what a file that does not load would have registered.
            raise PluginError(
                f"is not registered, and {unknown[0].origin}: {unknown[0].message}",
                plugin=f"{kind}/{name}",
                key=f"{key}.use",
            )
        known = [one.name for one in self.registrations(kind)]
        if not self.registrations():
            raise ConfigError(
                "no plug-ins are installed; install the project first: pip install -e . (or make run)",
                key=f"{key}.use",
            )
        listed = f"known: {choices(known)}" if known else f"no {kind} plug-in is registered"
        elsewhere = [one.kind for one in self.registrations() if one.name == name]
        other = f" ('{name}' is of kind {choices(elsewhere)})" if elsewhere else ""
        raise ConfigError(
            f"unknown {kind} '{name}'{did_you_mean(name, known)}; {listed}{other}", key=f"{key}.use"
        )

    def _from_class(self, kind: str, use: str, base_dir: Path, key: str) -> Registration:
        place, _, attribute = use.rpartition(":")
        made, module, name = locate_class(place, attribute, base_dir, kind=kind, key=f"{key}.use")
        origin = str(module.__file__ or place)
        # The class says what its options are, or the module that it stands in.
        config: Any = getattr(made, "Config", None) or getattr(module, "Config", PluginConfig)
        fault = _registration_fault(name, made, config)
        if fault:
            raise PluginError(fault, plugin=f"{kind}/{name}", file=origin, key=f"{key}.use")
        if origin not in self._paths:
            self._paths.append(origin)
        needs_truth = bool(getattr(made, "needs_truth", False))
        return Registration(kind, name, made, config, needs_truth, origin, "")


def _kind_of(entry_point: importlib.metadata.EntryPoint) -> str:
    """The kind that an entry point is named after, as in `perception.mine`; empty if after none."""
    kind, dot, _ = entry_point.name.partition(".")
    return kind if dot and kind in KINDS else ""


def describe_error(error: BaseException) -> str:
    """Type, text and, for a syntax error, line of an exception, on one line."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg} (line {error.lineno})"
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:300]}" if text else type(error).__name__


def _parts(slot: Slot | Mapping[str, Any], key: str) -> tuple[str, Mapping[str, Any]]:
    if isinstance(slot, Slot):
        return slot.use, slot.options
    checked = validate(Slot, slot, key=key) if isinstance(slot, Mapping) else None
    if checked is None:
        raise ConfigError(f"expected a mapping with `use`, got {describe(slot)}", key=key)
    return checked.use, checked.options


def _registration_fault(name: Any, factory: Any, config: Any) -> str:
    """What is wrong with a registration, or nothing."""
    if not (isinstance(name, str) and name and not any(one in name for one in ": \t\n/")):
        return f"a plug-in's name is text without blanks, ':' and '/', got {name!r}"
    if not callable(factory):
        return f"the factory of '{name}' is not callable: {describe(factory)}"
    if not (isinstance(config, type) and issubclass(config, PluginConfig)):
        return f"the config of '{name}' must be a subclass of dssmsg.hookspecs.PluginConfig, got {config!r}"
    return ""


def _collector(kind: str, origin: str, version: str, taken: list[Registration]) -> hookspecs.Register:
    def register(
        name: str, factory: Factory, *, config: type[PluginConfig] = PluginConfig, needs_truth: bool = False
    ) -> None:
        fault = _registration_fault(name, factory, config)
        if fault:
            raise TypeError(fault)
        taken.append(Registration(kind, name, factory, config, bool(needs_truth), origin, version))

    return register


def _hook_fault(plugin: Any, error: Exception) -> str:
    """pluggy's complaint about a hook in our words: which function, and what it should look like."""
    known = [f"register_{kind}" for kind in KINDS]
    for name in dir(plugin):
        if getattr(getattr(plugin, name, None), f"{hookspecs.PROJECT}_impl", None) is None:
            continue
        if name not in known:
            return f"unknown hook '{name}'{did_you_mean(name, known)}"
        return f"hook '{name}': its one argument must be called `register`"
    return describe_error(error)
