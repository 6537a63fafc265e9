"""Which contract a file fulfils: names first, then ranks, number types and fixed sizes; or what is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dssmsg.errors import ConfigError
from dssmsg.onnx.contracts import CONTRACTS, Contract, Tensor
from dssmsg.onnx.session import OnnxModel, Port

STRIDES = (8, 16, 32)
"""Cell sizes of the three grids of a YOLO head, pixels of its input."""


@dataclass(frozen=True, slots=True)
class Binding:
    """A file that fulfils a contract: which port plays which role, and the sizes that the graph fixes."""

    contract: Contract
    model: OnnxModel
    ports: Mapping[str, Port]
    sizes: Mapping[str, int]
    named: int
    """How many ports carry the names that exporters give."""

    def name(self, role: str) -> str:
        """The port's name for `OnnxModel.run`."""
        return self.ports[role].name

    def __contains__(self, role: str) -> bool:
        return role in self.ports


class _Misfit(Exception):
    """Why a file does not fulfil a contract. `depth` counts the names that are known, good or bad."""

    def __init__(self, reason: str, depth: int) -> None:
        super().__init__(reason)
        self.depth = depth


def candidates(model: OnnxModel) -> tuple[Binding, ...]:
    """All contracts that a file fulfils, the likeliest first: most known names, then most tensors told."""
    found = []
    for contract in CONTRACTS:
        try:
            found.append(_bind(contract, model))
        except _Misfit:
            continue
    return tuple(sorted(found, key=lambda one: (-one.named, bool(one.contract.refusal), -len(one.ports))))


def identify(model: OnnxModel, accepted: Sequence[str], *, key: str | None = None) -> Binding:
    """The contract of a file, one of `accepted`; `key` is the option that names the file, for errors.

    A file whose tensors bear the names of another contract is that one, whatever its shapes would allow.
    Raises ConfigError with what the file has, what it is if that is known, and what would fit.
    """
    found = candidates(model)
    fitting = [one for one in found if one.contract.name in accepted]
    if fitting and fitting[0].named >= found[0].named:
        return fitting[0]
    raise ConfigError(_refusal(model, found, accepted), file=model.path, key=key)


def describe_misfit(model: OnnxModel) -> str:
    """What a file has, and which known contract it comes nearest to."""
    nearest, reason = _nearest(model, CONTRACTS)
    near = f"; nearest is {nearest}; but {reason}" if reason else ""
    return f"fits no known contract: it {model.describe()}{near}"


def _refusal(model: OnnxModel, found: Sequence[Binding], accepted: Sequence[str]) -> str:
    wanted = [one for one in CONTRACTS if one.name in accepted]
    text = f"does not fit here: it {model.describe()}"
    if found:
        best = found[0]
        sure = best.named == len(best.ports)
        text += f"; {'that is' if sure else 'it could be'} {best.contract.title}"
        if best.contract.refusal:
            return f"{text}: {best.contract.refusal}"
        if best.contract.use:
            text += f", which goes into {best.contract.use}"
    nearest, reason = _nearest(model, wanted)
    text += f"; accepted here: {nearest}{f', but {reason}' if reason else ''}"
    others = [one.title for one in wanted if one is not nearest]
    return f"{text}; or {'; or '.join(others)}" if others else text


def _nearest(model: OnnxModel, among: Sequence[Contract]) -> tuple[Contract, str]:
    """The contract of which a file has the most names, and what is wrong; no reason if it has none."""
    best, depth, fault = among[0], 0, ""
    for contract in among:
        try:
            _bind(contract, model)
        except _Misfit as misfit:
            if misfit.depth > depth:
                best, depth, fault = contract, misfit.depth, str(misfit)
    return best, fault


def _bind(contract: Contract, model: OnnxModel) -> Binding:
    """The file as this contract, or _Misfit."""
    ports: dict[str, Port] = {}
    sizes: dict[str, int] = {}
    for tensors, given in ((contract.inputs, model.inputs), (contract.outputs, model.outputs)):
        for tensor in tensors:
            port = _by_name(tensor, given)
            if port is not None:
                ports[tensor.role] = port
    named = len(ports)
    for tensor in (*contract.inputs, *contract.outputs):
        if tensor.role in ports:
            fault = _fault(tensor, ports[tensor.role], sizes)
            if fault:
                raise _Misfit(f"{ports[tensor.role].name}: {fault}", named)
            _note_sizes(tensor, ports[tensor.role], sizes)
    for side, tensors, given in (
        ("input", contract.inputs, model.inputs),
        ("output", contract.outputs, model.outputs),
    ):
        missing = [tensor for tensor in tensors if tensor.role not in ports and not tensor.optional]
        free = [port for port in given if port not in ports.values()]
        _tell_by_shape(missing, free, ports, sizes, side, named)
        if free and not (contract.extra and side == "output"):
            raise _Misfit(f"it has {side}s too many: {', '.join(port.name for port in free)}", named)
    binding = Binding(contract, model, ports, sizes, named)
    fault = _meaning_fault(binding)
    if fault:
        raise _Misfit(fault, named)
    return binding


def _tell_by_shape(
    missing: list[Tensor],
    free: list[Port],
    ports: dict[str, Port],
    sizes: dict[str, int],
    side: str,
    named: int,
) -> None:
    """Give each missing tensor the one free port that fits it; none where two do, that would be a guess."""
    while missing:
        fitting = [(tensor, [port for port in free if not _fault(tensor, port, sizes)]) for tensor in missing]
        sure = [(tensor, found[0]) for tensor, found in fitting if len(found) == 1]
        if not sure or any(not found for _tensor, found in fitting):
            tensor = next((one for one, found in fitting if not found), missing[0])
            raise _Misfit(f"it has no {side} that is surely {tensor} {tensor.kind}", named)
        tensor, port = sure[0]
        ports[tensor.role] = port
        _note_sizes(tensor, port, sizes)
        missing.remove(tensor)
        free.remove(port)


def _by_name(tensor: Tensor, ports: Sequence[Port]) -> Port | None:
    """The port with the most usual of the tensor's names."""
    for name in tensor.names:
        for port in ports:
            if port.name.lower() == name:
                return port
    return None


def _fault(tensor: Tensor, port: Port, sizes: Mapping[str, int]) -> str:
    """What keeps a port from being this tensor, or nothing."""
    if tensor.kind == "float" and not port.is_float:
        return f"expected floating point numbers, has {port.dtype}"
    if tensor.kind == "int" and port.dtype not in ("int64", "int32"):
        return f"expected whole numbers (int64 or int32), has {port.dtype}"
    got = "(" + ", ".join("?" if one is None else str(one) for one in port.shape) + ")"
    if len(port.shape) != len(tensor.shape):
        return f"expected the shape of {tensor}, has {got}"
    here = dict(sizes)
    for axis, wanted in enumerate(tensor.shape):
        fixed = port.size(axis)
        if fixed is None:
            continue
        if isinstance(wanted, str):
            wanted = here.setdefault(wanted, fixed)
        if wanted is not None and fixed != wanted:
            return f"expected {wanted} on axis {axis}, as in {tensor}; has {got}"
    return ""


def _note_sizes(tensor: Tensor, port: Port, sizes: dict[str, int]) -> None:
    for axis, wanted in enumerate(tensor.shape):
        fixed = port.size(axis)
        if isinstance(wanted, str) and fixed is not None:
            sizes.setdefault(wanted, fixed)


def _meaning_fault(binding: Binding) -> str:
    """Rules that shapes alone do not say: the files that look alike."""
    name, ports, sizes = binding.contract.name, binding.ports, binding.sizes
    if name == "yolo-world-maps":
        outputs = binding.model.outputs
        if len(outputs) < 3 or any(len(port.shape) != 4 for port in outputs):
            return "it has other outputs than three or more feature maps"
    if name in ("yolo", "yolo-seg", "yolo-world-text"):
        masks = sizes.get("K", 32) if name == "yolo-seg" else 0
        if name != "yolo-world-text" and _is_list_of_boxes(ports["output"], sizes, masks):
            return "its rows are finished boxes, not anchors"
        least = 5 + masks
        sides = [ports["output"].size(axis) for axis in (1, 2)]
        channels = least if None in sides else min(side for side in sides if side is not None)
        if channels < least:
            return f"{ports['output'].name}: expected at least {least} channels, has {channels}"
    if name == "yolo-nms" and not _is_list_of_boxes(ports["output"], sizes, 0):
        return "its rows are anchors, not finished boxes"
    if name == "yolo-seg-nms" and not _is_list_of_boxes(ports["output"], sizes, sizes.get("K", 32)):
        return "its rows are anchors, not finished boxes"
    return ""


def _is_list_of_boxes(port: Port, sizes: Mapping[str, int], masks: int) -> bool:
    """Whether (1, rows, 6 + masks) holds boxes after NMS; one row an anchor would be a raw head.

    With two classes a raw head laid out (1, anchors, 6) has the same width: the number of anchors that the
    image size gives tells them apart.
    """
    rows, width = port.size(1), port.size(2)
    if width != 6 + masks:
        return False
    height, across = sizes.get("H"), sizes.get("W")
    return rows is None or height is None or across is None or rows != anchors(height, across)


def anchors(height: int, width: int) -> int:
    """How many anchors a YOLO head has for an image size in pixels: one a cell of three grids."""
    return sum((height // stride) * (width // stride) for stride in STRIDES)
