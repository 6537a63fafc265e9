"""Commands about model files: `models list`, `models get`, `models check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dssmsg.cli.options import JsonOption


def register(app: typer.Typer) -> None:
    """Add the group to the program."""
    group = typer.Typer(
        help="Get models that are not shipped, and tell what a model file is.",
        rich_markup_mode=None,
    )
    app.add_typer(group, name="models")

    @group.command("list")
    def list_models(as_json: JsonOption = False) -> None:
        """List the models that can be got, and whether they are there.

        \b
        Example:
          dssmsg models list
        """
        from dssmsg.cli.output import print_json
        from dssmsg.models.catalogue import CATALOGUE

        rows = [_row(name) for name in CATALOGUE]
        if as_json:
            print_json(rows)
            return
        for row in rows:
            print(f"{row['name']}  {row['state']}  {row['summary']}")
            print(f"    from {row['package']}, {row['licence']}; {row['credit']}")
            print(f"    {row['file']}, {row['size'] / 1e6:.0f} MB")

    @group.command("get")
    def get(
        name: Annotated[str, typer.Argument(metavar="NAME", help="As `models list` calls it.")],
        archive: Annotated[
            Path | None,
            typer.Option(
                "--from", metavar="FILE.tgz", help="Its package's tarball, where there is no network."
            ),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Fetch a model's package, convert the model to ONNX and keep it in the cache; prints the file.

        All files are checked by SHA-256. What is there already is not fetched again.

        \b
        Example:
          dssmsg models get NAME
        """
        from dssmsg.cli.output import note, print_json
        from dssmsg.models.catalogue import known_model
        from dssmsg.models.get import get_model

        model = known_model(name)
        path = get_model(model, archive, note)
        if as_json:
            print_json(_row(name))
        else:
            print(path)

    @group.command("check")
    def check(
        file: Annotated[Path, typer.Argument(metavar="FILE", help="An ONNX model.")],
        as_json: JsonOption = False,
    ) -> None:
        """Say what a model file is, and where it goes in the YAML; ends with 2 if it fits nowhere.

        \b
        Example:
          dssmsg models check model.onnx
        """
        from dssmsg.cli.output import print_json, stdout_to_stderr

        with stdout_to_stderr():
            facts = _examined(file)
        if as_json:
            print_json(facts)
            return
        for key, value in facts.items():
            if value:
                print(f"{key:<10}{', '.join(value) if isinstance(value, list) else value}")


def _row(name: str) -> dict[str, Any]:
    from dssmsg.models.cache import cached_path, state
    from dssmsg.models.catalogue import CATALOGUE

    model = CATALOGUE[name]
    return {
        "name": model.name,
        "state": state(model),
        "summary": model.summary,
        "file": str(cached_path(model)),
        "size": model.size,
        "sha256": model.sha256,
        "package": f"{model.package}@{model.version}",
        "package_bytes": model.package_bytes,
        "licence": model.licence,
        "credit": model.credit,
    }


def _examined(file: Path) -> dict[str, Any]:
    """What a model file is.

    Raises InputError where it does not load, or fits no contract that anything here can use.
    """
    from dssmsg.errors import InputError
    from dssmsg.models.catalogue import CATALOGUE
    from dssmsg.onnx.matching import candidates, describe_misfit
    from dssmsg.onnx.names import noted_names, summary
    from dssmsg.onnx.session import open_model

    model = open_model(file)
    found = candidates(model)
    if not found:
        raise InputError(describe_misfit(model), file=model.path)
    contract = found[0].contract
    if contract.refusal:
        raise InputError(f"is {contract.title}: {contract.refusal}", file=model.path)
    known = next((one.name for one in CATALOGUE.values() if one.sha256 == model.sha256), None)
    if contract.name == "nanodet" and known is None:
        raise InputError(
            "is a NanoDet, but not the one that `dssmsg models get coco` makes; detector coco takes no other",
            file=model.path,
        )
    names = noted_names(model)
    return {
        "file": str(model.path),
        "is": contract.title,
        "goes into": contract.use or None,
        "catalogue": known,
        "takes": [str(port) for port in model.inputs],
        "gives": [str(port) for port in model.outputs],
        "classes": None if names is None else summary(names),
        "sha256": model.sha256,
    }
