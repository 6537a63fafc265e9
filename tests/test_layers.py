"""Who may import whom, as data; read off the syntax tree, so that imports inside functions count too."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

VALUES = {
    "errors", "config_yaml", "frame", "events", "geometry", "neighbours", "interfaces", "checks", "processes",
    "target_graph",
}  # fmt: skip
"""What everybody may build on: values, contracts, exact geometry. Among themselves: see `ALLOWED`."""
HOST = {
    "config", "config_errors", "config_layers", "config_schema", "contexts",
    "guard", "hookspecs", "host", "host_files", "host_protocol", "slot_problems",
}  # fmt: skip
TOOLS = {
    "cluster", "depth_components", "dynamic_attribute", "lexicon", "level_surfaces", "lift", "llm_requests",
    "purposes",
}  # fmt: skip
"""Algorithms that mission or plug-ins use."""

ALLOWED: dict[str, set[str]] = {
    # values and contracts
    "errors": set(),
    "config_yaml": {"errors"},  # reads any YAML with bounds; knows nothing of the configuration
    "frame": set(),
    "geometry": {"frame"},
    "neighbours": {"frame"},
    "processes": set(),
    "events": {"frame", "graph", "interfaces"},  # `interfaces` for annotations only
    "interfaces": {"frame", "events", "graph"},
    "checks": {"frame", "events", "graph", "interfaces"},
    "target_graph": {"interfaces"},
    "graph": {"errors", "frame", "geometry", "neighbours"},
    "baselines": {"cluster", "frame", "geometry", "graph"},
    # the host and what stands beside it
    "host": VALUES | HOST | {"graph"},
    "tools": VALUES | TOOLS,
    "llm": VALUES | TOOLS | {"config", "hookspecs"},
    "models": {"errors"},
    "onnx": {"errors", "frame"},
    "navigation": {"frame", "geometry", "interfaces"},
    "sequences": {"errors", "frame"},
    "sim": {"errors", "config_yaml", "frame", "interfaces"},
    "recogniser": {"errors", "frame", "sim", "geometry", "depth_components", "config_yaml"},
    "recording": {"errors", "frame", "interfaces", "events", "geometry", "graph", "processes"},
    # what puts them together
    "mission": VALUES | HOST | TOOLS | {"graph", "llm", "navigation", "recording"},
    "evaluate": VALUES
    | HOST
    | {"graph", "lift", "mission", "purposes", "recording", "recogniser", "review", "sim"},
    "review": VALUES | {"graph", "lexicon", "recording"},
    "data": {"frame", "hookspecs"},  # the template of a plug-in
    "__main__": {"cli"},
    # `cli` may import everything, and only `__main__` imports it
}
PLUGINS_MAY = VALUES | TOOLS | {"config", "hookspecs", "graph"}
PLUGIN_LIBRARIES = {
    "baselines", "llm", "models", "navigation", "onnx", "recogniser", "recording", "review", "sequences",
    "sim",
}  # fmt: skip


def imports(path: Path) -> Iterator[str]:
    """The full dotted names that a file imports; of `from a import b` both `a` and `a.b`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            yield node.module
            yield from (f"{node.module}.{one.name}" for one in node.names)


def parts(path: Path) -> set[str]:
    """The first-level parts of dssmsg (`graph`, `frame`, ...) that a file imports."""
    known = {one.stem for one in (ROOT / "dssmsg").iterdir()} - {"__init__"}
    names = (name.split(".") for name in imports(path))
    return {name[1] for name in names if name[0] == "dssmsg" and len(name) > 1 and name[1] in known}


def files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def home(path: Path) -> str:
    """The part that a file of dssmsg belongs to; modules of one purpose go together."""
    part = path.relative_to(ROOT / "dssmsg").parts[0].removesuffix(".py")
    return "host" if part in HOST else "tools" if part in TOOLS else part


def violations() -> set[tuple[str, str]]:
    """(file, part it must not import)."""
    found = set()
    for path in files("dssmsg"):
        here = home(path)
        if here not in {"cli", "__init__"}:
            found |= {(path, part) for part in parts(path) - ALLOWED[here] - {here}}
    for path in files("plugins"):
        found |= {(path, part) for part in parts(path) - PLUGINS_MAY - PLUGIN_LIBRARIES}
    return {(str(path.relative_to(ROOT)), part) for path, part in found}


def test_layers_import_downwards_only() -> None:
    assert violations() == set()


def test_every_part_has_a_place() -> None:
    placed = set(ALLOWED) | HOST | TOOLS | {"cli", "__init__"}
    assert {
        path.relative_to(ROOT / "dssmsg").parts[0].removesuffix(".py") for path in files("dssmsg")
    } <= placed


def test_the_program_knows_no_plugin() -> None:
    for path in files("dssmsg"):
        assert not [name for name in imports(path) if name.split(".")[0] in {"dssmsg_plugins", "plugins"}], (
            path
        )


def test_plugins_do_not_know_each_other() -> None:
    for path in files("plugins"):
        own = ".".join(("dssmsg_plugins", *path.relative_to(ROOT / "plugins").with_suffix("").parts))
        others = [name for name in imports(path) if name.split(".")[0] in {"dssmsg_plugins", "plugins"}]
        assert all(name.startswith(own) for name in others), (path, others)


@pytest.mark.parametrize(
    ("text", "named"),
    [("def f():\n    from dssmsg.cli import main", "dssmsg.cli"), ("from dssmsg import cli", "dssmsg.cli")],
)
def test_imports_are_found_wherever_they_stand(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "a.py"
    path.write_text(text)
    assert named in set(imports(path))
    assert parts(path) == {"cli"}
