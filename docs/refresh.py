"""Writes what the program knows into these documents: help texts, option tables, the example plug-in.

    python docs/refresh.py

Between `<!-- begin NAME -->` and `<!-- end NAME -->` stands generated text. A test compares.
"""

from __future__ import annotations

import ast
import io
import json
import os
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from importlib import resources
from pathlib import Path
from unittest import mock

from dssmsg.cli import main
from dssmsg.config import SLOT_KINDS, MissionConfig, RecordingConfig, RunConfig
from dssmsg.config_schema import options_of
from dssmsg.hookspecs import PluginConfig
from dssmsg.host import Host
from dssmsg.interfaces import KINDS

FOLDER = Path(__file__).parent
TESTS = FOLDER.parent / "tests"
_BLOCK = re.compile(r"<!-- begin ([^>]+?) -->\n.*?<!-- end \1 -->", re.DOTALL)


def refreshed(name: str) -> str:
    """The document `name` of this folder with its generated parts as they should be now."""
    text = (FOLDER / name).read_text(encoding="utf-8")
    return _BLOCK.sub(
        lambda found: f"<!-- begin {found[1]} -->\n{_generated(found[1])}<!-- end {found[1]} -->", text
    )


def _generated(what: str) -> str:
    kind, _, argument = what.partition(" ")
    if kind == "help":
        return _help(argument)
    if kind == "file":
        path = Path(str(resources.files("dssmsg") / "data" / argument))
        return f"```{'yaml' if path.suffix == '.yaml' else 'python'}\n{path.read_text(encoding='utf-8')}```\n"
    if kind == "example":
        return f"```python\n{_example(argument)}```\n"
    if kind == "options":
        models: dict[str, type] = {"run": RunConfig, "mission": MissionConfig, "recording": RecordingConfig}
        return _table(models[argument])
    if kind == "plugins":
        return "\n".join(_plugins())
    raise ValueError(f"nobody knows how to generate {what!r}")


def _example(kind: str) -> str:
    """The tests' plug-in of a kind as a file of its own: its hook, and what of its module that needs."""
    for path in (TESTS / "example_plugins.py", TESTS / "fake_plugins.py"):
        text = path.read_text(encoding="utf-8")
        body = ast.parse(text).body
        needed = {f"register_{kind}"}
        kept: dict[int, ast.stmt] = {}
        while fresh := [node for node in body if node.lineno not in kept and _defined(node) & needed]:
            for node in fresh:
                kept[node.lineno] = node
                needed |= {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}
        if not kept:
            continue
        blocks, after_imports = [], False
        for node in body:
            if isinstance(node, ast.ImportFrom):
                node.names = [one for one in node.names if (one.asname or one.name) in needed]
            if node.lineno in kept:
                imported = isinstance(node, ast.Import | ast.ImportFrom)
                first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", ()))])
                code = (
                    ast.unparse(node)
                    if imported
                    else "\n".join(text.split("\n")[first - 1 : node.end_lineno])
                )
                blocks.append(code if imported and not after_imports else f"\n\n{code}")
                after_imports = after_imports or not imported
        return "\n".join(blocks).strip() + "\n"
    raise ValueError(f"the tests have no plug-in of the kind {kind!r}")


def _defined(node: ast.stmt) -> set[str]:
    """The names that a statement of a module brings into it."""
    if isinstance(node, ast.ImportFrom) and node.module == "__future__":
        return set()
    if isinstance(node, ast.Import | ast.ImportFrom):
        return {one.asname or one.name for one in node.names}
    if isinstance(node, ast.Assign):
        return {one.id for one in node.targets if isinstance(one, ast.Name)}
    return {node.name} if isinstance(node, ast.ClassDef | ast.FunctionDef) else set()


def _help(command: str) -> str:
    arguments = [*command.split(), "--help"]
    out = io.StringIO()
    with redirect_stdout(out), mock.patch.dict(os.environ, {"COLUMNS": "80"}):
        main(arguments)
    return f"```text\n$ {' '.join(['dssmsg', *arguments])}\n{out.getvalue()}```\n"


def _table(model: type) -> str:
    rows = options_of(model)
    if not rows:
        return "No options.\n"
    lines = ["| option | accepted | default | meaning |", "|---|---|---|---|"]
    for row in rows:
        slot = row["name"] in SLOT_KINDS or row["name"] == "diagnosis"
        kind = "`{use: ..., options}`" if slot else _cell(row["type"])
        default = "required" if row["required"] else f"`{json.dumps(row['default'], ensure_ascii=False)}`"
        if slot:
            default = "see below"
        lines.append(f"| `{row['name']}` | {kind} | {default} | {_cell(row['description'])} |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")


def _plugins() -> Iterator[str]:
    host = Host.load()
    for kind in KINDS:
        for one in host.registrations(kind):
            if one.version and one.origin.startswith("dssmsg: "):
                truth = " It sees the simulator's truth." if one.needs_truth else ""
                text = (
                    (one.config.__doc__ or "").strip().splitlines() if one.config is not PluginConfig else []
                )
                yield f"### {kind}: `{one.name}`\n"
                if (text and one.config.__doc__ != PluginConfig.__doc__) or truth:
                    own = text[0] if text and one.config.__doc__ != PluginConfig.__doc__ else ""
                    yield f"{own}{truth}".strip() + "\n"
                yield _table(one.config)


def write() -> None:
    """Refresh every document that has generated parts."""
    for path in sorted(FOLDER.glob("*.md")):
        new = refreshed(path.name)
        if new != path.read_text(encoding="utf-8"):
            path.write_text(new, encoding="utf-8")
            print(f"refreshed {path.name}")


if __name__ == "__main__":
    write()
