"""`check_model`: what a model file is, where it goes in the YAML, and what it takes and gives."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dssmsg.errors import InputError
from dssmsg.onnx.matching import Binding, candidates, describe_misfit
from dssmsg.onnx.names import noted_names
from dssmsg.onnx.session import OnnxModel, open_model


@dataclass(frozen=True, slots=True)
class ModelReport:
    """A file that fulfils a known contract.

    `kind` is the kind of plug-in that takes it (detector, segmenter, ...; empty if none does), `use` how to
    write that; `also` are other contracts that its shapes would allow, `refusal` why nothing can use it.
    """

    file: str
    sha256: str
    size_bytes: int
    kind: str
    contract: str
    title: str
    use: str
    refusal: str
    also: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sizes: dict[str, int]
    classes: tuple[str, ...] | None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    def lines(self) -> list[str]:
        """The report for a reader, one finding a line."""
        text = [
            f"{self.file}: {self.title} ({self.contract})",
            f"  sha256   {self.sha256}, {self.size_bytes / 1e6:.1f} MB",
            f"  takes    {', '.join(self.inputs)}",
            f"  gives    {', '.join(self.outputs)}",
        ]
        if self.classes is not None:
            dots = ", ..." if len(self.classes) > 12 else ""
            text.append(f"  classes  {len(self.classes)}: {', '.join(self.classes[:12])}{dots}")
        text.append(f"  refused  {self.refusal}" if self.refusal else f"  use      {self.use}")
        if self.also:
            text.append(f"  its names are not known; by its shapes it could also be: {', '.join(self.also)}")
        return text


def check_model(path: str | Path) -> ModelReport:
    """Tell what a file is. Raises InputError if it is missing, no ONNX model, or fits no known contract."""
    model = open_model(path)
    found = candidates(model)
    if not found:
        raise InputError(describe_misfit(model), file=model.path)
    best = found[0]
    rivals = [one.contract.title for one in found[1:] if one.named == best.named and not one.contract.refusal]
    return _report(model, best, tuple(rivals))


def _report(model: OnnxModel, binding: Binding, also: tuple[str, ...]) -> ModelReport:
    contract = binding.contract
    return ModelReport(
        file=str(model.path),
        sha256=model.sha256,
        size_bytes=model.path.stat().st_size,
        kind=contract.use.partition(":")[0],
        contract=contract.name,
        title=contract.title,
        use=contract.use.replace("FILE", model.path.name),
        refusal=contract.refusal,
        also=also,
        inputs=tuple(map(str, model.inputs)),
        outputs=tuple(map(str, model.outputs)),
        sizes=dict(binding.sizes),
        classes=noted_names(model),
    )
