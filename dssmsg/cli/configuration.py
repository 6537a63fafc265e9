"""`dssmsg config`: the resolved configuration or its schema."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dssmsg.cli.output import print_json, stdout_to_stderr
from dssmsg.config import load_config
from dssmsg.config_schema import file_schema
from dssmsg.config_yaml import dump_yaml
from dssmsg.host import Host


def show_config(path: Path | None, sets: Sequence[str], *, schema: bool, as_json: bool) -> None:
    """Print the resolved configuration as YAML (or JSON), or the JSON schema of a file."""
    with stdout_to_stderr():
        config = load_config(path, sets=sets)
        with config.naming_files():
            host = Host.load(config.plugins, config.base_dir)
        value = file_schema(host) if schema else None
        if value is None:
            host.refuse_clashes()
            value = host.resolved(config)
    if schema or as_json:
        print_json(value)
    else:
        print(dump_yaml(value), end="")
