"""The host: loading, its rules on what is broken, resolving and building."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from project import FAKE_RUN, FAKES, project

from dssmsg.config import load_config
from dssmsg.contexts import ContextFactory, plugin_rng
from dssmsg.errors import ConfigError, PluginError
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.hookspecs import PluginConfig, hookimpl
from dssmsg.host import Host
from dssmsg.interfaces import KINDS

GOOD = """
from pydantic import Field
from dssmsg.hookspecs import PluginConfig, hookimpl

class Config(PluginConfig):
    level: float = Field(0.5, ge=0, description="How much.")

class Detector:
    feature_space = None
    Config = Config
    needs_truth = True
    def __init__(self, config, context):
        self.config, self.context = config, context
    def detect(self, frame):
        return []

@hookimpl
def register_perception(register):
    register("mine", Detector, config=Config)
"""


def load(
    folder: Path, files: Mapping[str, str], *paths: str, entry_points: tuple[EntryPoint, ...] = ()
) -> Host:
    project(folder, files)
    return Host.load(paths or tuple(files), folder, entry_points=entry_points)


def problem(folder: Path, text: str) -> str:
    """The one problem that a plug-in file makes."""
    host = load(folder, {"bad.py": text})
    (found,) = host.problems
    assert found.origin == str(folder / "bad.py")
    assert host.registrations() == ()
    return found.message


def contexts(host: Host, folder: Path, seed: int = 0) -> ContextFactory:
    return ContextFactory(host, seed, SceneGraph(), IdAllocator(), folder, folder / "recordings", "run")


def module_entry(name: str, **functions: Any) -> EntryPoint:
    """An entry point to a module that exists in memory only."""
    module = ModuleType(f"dssmsg_test_{name.replace('.', '_')}")
    for key, value in functions.items():
        setattr(module, key, value)
    sys.modules[module.__name__] = module
    return EntryPoint(name, module.__name__, "dssmsg")


def test_file_registers_and_builds(tmp_path: Path) -> None:
    host = load(tmp_path, {"mine.py": GOOD})
    (one,) = host.registrations()
    assert (one.id, one.origin, one.needs_truth) == ("perception/mine", str(tmp_path / "mine.py"), False)
    built = host.build("perception", {"use": "mine", "level": 2}, contexts(host, tmp_path))
    assert built.plugin.config.level == 2.0
    assert built.plugin.context.base_dir == tmp_path
    assert type(built.plugin).__module__ == "dssmsg_user.mine"
    assert sys.modules["dssmsg_user.mine"] is not None
    assert str(tmp_path) not in sys.path
    assert host.paths == (str(tmp_path / "mine.py"),)


def test_directory_is_loaded_sorted_without_underscores_and_not_deeper(tmp_path: Path) -> None:
    def named(name: str) -> str:
        return GOOD.replace('"mine"', f'"{name}"')

    host = load(
        tmp_path,
        {
            "d/b.py": named("b"),
            "d/a.py": named("a"),
            "d/_c.py": "raise SystemExit",
            "d/deep/e.py": named("e"),
            "d/f.txt": "",
        },
        "d",
        "d/a.py",
    )
    assert [Path(path).name for path in host.paths] == ["a.py", "b.py"]
    assert [one.name for one in host.registrations("perception")] == ["a", "b"]
    assert host.problems == ()  # a.py, listed a second time, is skipped


def test_every_kind_can_be_registered_and_is_held_against_its_protocol(tmp_path: Path) -> None:
    host = Host.load([FAKES], entry_points=())
    assert host.problems == ()
    kinds = [one.kind for one in host.registrations()]
    assert kinds == [kind for kind in KINDS if kind not in ("tagger", "detector", "segmenter", "diagnosis")]
    made = contexts(host, tmp_path)
    for kind in kinds:
        plugin = host.build(kind, {"use": "fake"}, made).plugin
        if hasattr(plugin, "close"):
            plugin.close()
    for kind in ("source", "encoder", "llm", "association", "update", "grounding", "navigation"):
        other = {"use": f"{FAKES}:Fake{kind.capitalize()}"}
        with pytest.raises(PluginError, match=r"a perception plug-in \(Perception\) must have"):
            host.build("perception", other, made)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise ValueError('no GPU here')", "failed to load: ValueError: no GPU here"),
        ("import not_there_at_all", "No module named 'not_there_at_all'"),
        ("def x(:\n  pass", "SyntaxError: invalid syntax (line 1)"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("x = 1", "registers nothing: mark a function"),
        (GOOD.replace("@hookimpl\n", ""), "registers nothing"),
        (GOOD.replace("register_perception", "register_percepton"), "did you mean 'register_perception'"),
        (GOOD.replace("(register):", "(registry):"), "must be called `register`"),
        (GOOD.replace('register("mine", Detector', 'register("mine", "Detector"'), "not callable"),
        (GOOD.replace("config=Config)", "config=dict)"), "subclass of dssmsg.hookspecs.PluginConfig"),
        (GOOD.replace('"mine"', '"my detector"'), "without blanks"),
        (
            GOOD.replace('register("mine", Detector, config=Config)', "register(Detector)"),
            "missing 1 required",
        ),
        (
            GOOD.replace('register("mine", Detector, config=Config)', "raise OSError('gone')"),
            "register_perception: OSError: gone",
        ),
    ],
)
def test_broken_files_are_problems_not_ends(tmp_path: Path, text: str, words: str) -> None:
    assert words in problem(tmp_path, text)


def test_broken_file_leaves_the_others_alone(tmp_path: Path) -> None:
    host = load(
        tmp_path,
        {
            "a.py": "raise OSError('x')",
            "b.py": GOOD,
            "c.py": GOOD.replace("register_p", "register_q").replace("mine", "c"),
        },
    )
    assert [one.name for one in host.registrations()] == ["mine"]
    assert len(host.problems) == 2


def test_hook_that_fails_half_way_registers_nothing(tmp_path: Path) -> None:
    assert "boom" in problem(tmp_path, GOOD + "    raise OSError('boom')\n")


def test_missing_and_odd_paths_are_refused(tmp_path: Path) -> None:
    for path, words in (
        ("gone.py", "does not exist"),
        ("a.txt", "expected a Python file"),
        ("my-det.py", "a name like"),
    ):
        project(tmp_path, {"a.txt": "", "my-det.py": GOOD})
        with pytest.raises(ConfigError, match=words) as caught:
            Host.load(["./", path], tmp_path, entry_points=())
        assert caught.value.key == "plugins[1]"


def test_same_stem_in_two_folders_both_work(tmp_path: Path) -> None:
    host = load(tmp_path, {"a/det.py": GOOD, "b/det.py": GOOD.replace('"mine"', '"other"')})
    assert [one.name for one in host.registrations()] == ["mine", "other"]


def test_clash_names_both_owners_and_stops_runs(tmp_path: Path) -> None:
    host = load(tmp_path, {"a.py": GOOD, "b.py": GOOD})
    (clash,) = host.problems
    assert clash.clash
    assert str(tmp_path / "a.py") in clash.message
    assert clash.origin == str(tmp_path / "b.py")
    with pytest.raises(ConfigError, match="already registered"):
        host.refuse_clashes()


def test_entry_points_are_loaded_guarded_and_one_at_a_time(tmp_path: Path) -> None:
    @hookimpl
    def register_llm(register: Any) -> None:
        register("good", lambda config, context: None)

    good = module_entry("llm.good", register_llm=register_llm)
    bad = EntryPoint("llm.bad", "dssmsg_not_there", "dssmsg")
    host = Host.load((), tmp_path, entry_points=(bad, good))
    assert [one.id for one in host.registrations()] == ["llm/good"]
    (found,) = host.problems
    assert (found.kind, found.name) == ("llm", "bad")
    with pytest.raises(PluginError, match="llm/bad: failed to load: ModuleNotFoundError") as caught:
        host.resolve("llm", {"use": "bad"})
    assert caught.value.key == "llm.use"
    with pytest.raises(PluginError, match="factory returned nothing"):
        host.build("llm", {"use": "good"}, contexts(host, tmp_path))


def test_kinds_that_nobody_asks_for_are_not_imported(tmp_path: Path) -> None:
    broken = EntryPoint("llm.bad", "dssmsg_not_there", "dssmsg")
    unnamed = EntryPoint("theirs", "dssmsg_not_there_either", "dssmsg")
    host = Host.load((), tmp_path, entry_points=(broken, unnamed), kinds=("diagnosis",))
    assert [one.name for one in host.problems] == ["theirs"]  # it may register anything
    assert host.registrations("diagnosis") == ()
    assert len(host.problems) == 1
    with pytest.raises(PluginError, match="llm/bad: failed to load"):
        host.resolve("llm", {"use": "bad"})
    assert [one.name for one in host.problems] == ["theirs", "bad"]


def test_installed_package_with_an_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `pip install` of somebody's package leaves behind, found without naming it anywhere."""
    project(
        tmp_path,
        {
            "theirs/__init__.py": "",
            "theirs/eyes.py": GOOD,
            "theirs-2.1.dist-info/METADATA": "Metadata-Version: 2.1\nName: theirs\nVersion: 2.1\n",
            "theirs-2.1.dist-info/entry_points.txt": "[dssmsg]\nperception.mine = theirs.eyes\n",
        },
    )
    monkeypatch.syspath_prepend(tmp_path)
    (one,) = [one for one in Host.load((), tmp_path).registrations("perception") if one.name == "mine"]
    assert (one.origin, one.version) == ("theirs: theirs.eyes", "2.1")


def test_unknown_names_list_the_known(tmp_path: Path) -> None:
    host = Host.load([FAKES], tmp_path, entry_points=())
    with pytest.raises(ConfigError, match=r"unknown llm 'fak'; did you mean 'fake'\?; known: fake"):
        host.resolve("llm", {"use": "fak"})
    with pytest.raises(ConfigError, match=r"no tagger plug-in is registered \('fake' is of kind"):
        host.resolve("tagger", {"use": "fake"})
    with pytest.raises(ConfigError, match="pip install -e"):
        Host.load((), tmp_path, entry_points=()).resolve("llm", {"use": "fake"})


def test_unknown_name_with_a_broken_file_points_at_the_file(tmp_path: Path) -> None:
    host = load(tmp_path, {"mine.py": "raise OSError('gone')"})
    with pytest.raises(PluginError, match=r"mine\.py: failed to load: OSError: gone"):
        host.resolve("perception", {"use": "mine"})


@pytest.mark.parametrize(
    ("options", "key", "words"),
    [
        ({"levle": 1}, "perception.levle", "did you mean 'level'"),
        ({"level": "much"}, "perception.level", "expected a number, got 'much'"),
        ({"level": -1}, "perception.level", ">= 0"),
        ({"level": float("nan")}, "perception.level", "finite"),
        ({"level": [1]}, "perception.level", "a list of 1"),
    ],
)
def test_options_are_the_plugins_own(tmp_path: Path, options: dict[str, Any], key: str, words: str) -> None:
    host = load(tmp_path, {"mine.py": GOOD})
    with pytest.raises(ConfigError, match=words) as caught:
        host.resolve("perception", {"use": "mine", **options})
    assert caught.value.key == key


def test_check_names_the_file_that_is_to_blame(tmp_path: Path) -> None:
    folder = project(
        tmp_path,
        {
            "base.yaml": f"plugins: [{FAKES}]\nsource: {{use: fake, framez: 3}}\n",
            "my.yaml": "include: base.yaml\nseed: 3\n",
        },
    )
    config = load_config(folder.path / "my.yaml", environment={})
    host = Host.load(config.plugins, config.base_dir, entry_points=())
    with pytest.raises(ConfigError, match="did you mean 'frames'") as caught:
        host.check(config)
    assert (caught.value.file, caught.value.key) == (str(tmp_path / "base.yaml"), "source.framez")


def test_class_of_a_file_and_of_a_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    host = load(tmp_path, {"sub/det.py": GOOD, "pack/__init__.py": "", "pack/det.py": GOOD}, "sub/det.py")
    made = contexts(host, tmp_path)
    built = host.build("perception", {"use": "sub/det.py:Detector", "level": 3}, made, base_dir=tmp_path)
    assert built.plugin.config.level == 3
    assert built.registration.needs_truth
    assert built.registration.id == "perception/det.Detector"
    monkeypatch.syspath_prepend(tmp_path)
    again = host.build("perception", {"use": "pack.det:Detector"}, made)
    assert again.registration.id == "perception/pack.det.Detector"


@pytest.mark.parametrize(
    ("use", "error", "words"),
    [
        ("det.py:Detectr", ConfigError, "no class 'Detectr'; did you mean 'Detector'"),
        ("gone.py:Detector", ConfigError, "no such file"),
        ("no_such_package.x:Detector", ConfigError, "no module 'no_such_package'"),
        ("json:Detector", ConfigError, "has no class"),
        ("bad.py:Detector", PluginError, "failed to load: OSError: x"),
        ("det.py:VALUE", PluginError, "not callable"),
        ("det.py:Loose", PluginError, "subclass of dssmsg.hookspecs.PluginConfig"),
        ("det.py:Raises", PluginError, r"could not be built: RuntimeError: no weights"),
        ("det.py:Needs", PluginError, "needs the Python module 'nowhere_to_be_found'"),
        ("det.py:NoDetect", PluginError, r"NoDetect has no method detect\(frame\)"),
        ("det.py:NoSpace", PluginError, "NoSpace has no attribute 'feature_space'"),
        ("det.py:Async", PluginError, "async"),
        ("det.py:Narrow", PluginError, r"must take \(frame\)"),
        ("det.py:make_class", PluginError, "the class Detector itself"),
    ],
)
def test_classes_that_do_not_fit(tmp_path: Path, use: str, error: type[Exception], words: str) -> None:
    more = """
VALUE = 3
class Loose(Detector):
    Config = dict
class Raises(Detector):
    def __init__(self, config, context):
        raise RuntimeError("no weights")
class Needs(Detector):
    def __init__(self, config, context):
        import nowhere_to_be_found
class NoDetect:
    feature_space = None
    def __init__(self, config, context): pass
class NoSpace:
    def __init__(self, config, context): pass
    def detect(self, frame): return []
class Async(Detector):
    async def detect(self, frame): return []
class Narrow(Detector):
    def detect(self): return []
def make_class(config, context):
    return Detector
"""
    project(tmp_path, {"det.py": GOOD + more, "bad.py": "raise OSError('x')"})
    host = Host.load((), tmp_path, entry_points=())
    with pytest.raises(error, match=words) as caught:
        host.build("perception", {"use": use}, contexts(host, tmp_path), base_dir=tmp_path)
    assert str(getattr(caught.value, "key", None)).startswith("perception")


def test_context_builds_links_with_contexts_of_their_own(tmp_path: Path) -> None:
    host = Host.load([FAKES], tmp_path, entry_points=())
    made = contexts(host, tmp_path, seed=7)
    one = made(host.resolve("perception", {"use": "fake"})[0])
    assert one.build("encoder", {"use": "fake"}).dimension == 4
    with pytest.raises(ConfigError) as caught:
        one.build("encoder", {"use": "nothing"})
    assert caught.value.key == "perception.encoder.use"
    with pytest.raises(ConfigError, match="expected a mapping with `use`, got 'fake'"):
        one.build("encoder", "fake")


def test_generators_depend_on_seed_kind_and_name_alone() -> None:
    draws = {
        (seed, kind, name): tuple(plugin_rng(seed, kind, name).integers(0, 2**62, 3).tolist())
        for seed in (0, 1)
        for kind in ("source", "perception")
        for name in ("a", "b")
    }
    assert len(set(draws.values())) == len(draws)
    assert draws[0, "source", "a"] == tuple(plugin_rng(0, "source", "a").integers(0, 2**62, 3).tolist())
    # Pinned: the same seed must give the same run in every later version, too.
    assert plugin_rng(0, "source", "pybullet").integers(0, 1000, 4).tolist() == [566, 335, 799, 713]


def test_config_with_no_options_accepts_none() -> None:
    class Sub(PluginConfig):
        pass

    @hookimpl
    def register_llm(register: Any) -> None:
        register("plain", lambda config, context: None, config=Sub)

    host = Host.load((), entry_points=(module_entry("llm.plain", register_llm=register_llm),))
    with pytest.raises(ConfigError, match="nothing can be set here"):
        host.resolve("llm", {"use": "plain", "x": 1})


def test_resolved_shows_every_option(tmp_path: Path) -> None:
    folder = project(tmp_path, {"my.yaml": FAKE_RUN})
    config = load_config(folder.path / "my.yaml", environment={})
    host = Host.load(config.plugins, config.base_dir, entry_points=())
    values = host.resolved(config)
    assert values["source"] == {"use": "fake", "frames": 3, "width": 32}
    assert values["recording"]["observers"] == {"fake": {"use": "fake"}, "rerun": False}
    assert sorted(host.check(config)) == sorted(config.slots)
