"""tagger/ram: names what is in a frame by a RAM or RAM++ file of the user's.

The model takes seconds a frame on a CPU; it is asked on key frames only, like all of perception.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.frame import Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.onnx.matching import identify
from dssmsg.onnx.names import NameList, baked_names
from dssmsg.onnx.problems import problems_of
from dssmsg.onnx.ram import Ram, read_thresholds
from dssmsg.onnx.scores import ScoreKind
from dssmsg.onnx.session import FilePath, Sha256, Threads, open_model

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder

Share = Annotated[float, Field(ge=0, le=1)]


class Config(PluginConfig):
    """Options of the tagger `ram`; paths start from the folder of the YAML."""

    model: FilePath = Field(description="The ONNX file.")
    tags: NameList | None = Field(
        None,
        description="The tag list, a text file with one a line (ram_tag_list.txt), in the model's order.",
    )
    threshold: Share | FilePath = Field(
        0.68,
        description="Least score of a tag: a number, or a text file with one a tag "
        "(ram_tag_list_threshold.txt). It changes nothing where the thresholds lie inside the model.",
    )
    exclude: tuple[str, ...] = Field(
        (), description="Tags never to report, such as room, floor, living room: what is no object."
    )
    limit: int = Field(40, ge=1, le=1000, description="Most tags a frame.")
    scores: ScoreKind = Field(
        "auto", description="What the scores are; auto: logits if one lies outside 0..1."
    )
    threads: Threads = Field(1, description="Threads of the model.")
    sha256: Sha256 | None = Field(None, description="SHA-256 of the file; another file is refused.")

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What is wrong with the files, one sentence each, beginning with the option."""
        return problems_of(lambda: RamTagger(self, base_dir))


class RamTagger:
    """Tags a whole frame."""

    def __init__(self, config: Config, base_dir: Path) -> None:
        """Raises ConfigError or InputError if the files do not fit, here or together."""
        model = open_model(
            config.model, base_dir=base_dir, threads=config.threads, sha256=config.sha256, key=".model"
        )
        self._ram = Ram(identify(model, ("ram",), key=".model"), config.scores)
        count = self._ram.tag_count
        self._names = baked_names(model, count, config.tags, base_dir, key=".tags")
        self._thresholds = read_thresholds(config.threshold, count, base_dir)
        self._limit = config.limit
        unknown = [name for name in config.exclude if name not in self._names]
        if unknown:
            raise ConfigError(f"no such tags: {', '.join(unknown)}", file=model.path, key=".exclude")
        self._excluded = np.isin(np.array(self._names), config.exclude)

    def tags(self, frame: Frame) -> Sequence[str]:
        """Tags above their thresholds, highest score first, equal scores in the order of the list."""
        scores = self._ram.scores(frame.rgb)
        if len(scores) != len(self._names):
            raise ValueError(f"expected {len(self._names)} scores, got {len(scores)}")
        order = np.argsort(-scores, kind="stable")
        chosen = order[(scores[order] > self._thresholds[order]) & ~self._excluded[order]]
        return [self._names[place] for place in chosen[: self._limit]]


def make(config: Config, context: Context) -> RamTagger:
    """The factory."""
    return RamTagger(config, context.base_dir)


@hookimpl
def register_tagger(register: Register) -> None:
    """`ram`: tags by a file of the user's."""
    register("ram", make, config=Config)
