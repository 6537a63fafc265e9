"""What a configuration's plug-ins say of their files before anything runs.

A plug-in's config model may have a method

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]

that looks at the files it names and gives a sentence for each that does not fit, beginning with the option:
`model: /home/me/x.onnx: no such file`. `base_dir` is the folder of the YAML, where relative paths start;
`encoder` is the run's encoder, None where it could not be built. Slots inside an option (the links of a
chain) are asked too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from dssmsg.config import RunConfig, Slot, kind_of
from dssmsg.errors import DssmsgError
from dssmsg.host import Host, describe_error
from dssmsg.interfaces import KINDS, Encoder


def slot_problems(host: Host, config: RunConfig, encoder: Encoder | None) -> Iterator[str]:
    """Every problem as `dotted.key: sentence`; a plug-in or option that is wrong in itself is one too."""
    for key, slot in config.slots.items():
        yield from problems_of_slot(host, kind_of(key), slot, key, config.base_dir, encoder)


def problems_of_slot(
    host: Host, kind: str, slot: Slot, key: str, base_dir: Path, encoder: Encoder | None
) -> Iterator[str]:
    """The same of one slot alone."""
    try:
        registration, options = host.resolve(kind, slot, base_dir, key)
        ask = getattr(options, "problems", None)
        found = list(ask(base_dir, encoder)) if callable(ask) else []
    except DssmsgError as error:
        yield str(error)
        return
    except Exception as error:
        yield f"{key}: plug-in {registration.id} could not look at its files: {describe_error(error)}"
        return
    for sentence in found:
        yield f"{key}.{sentence}"
    for name in type(options).model_fields:
        value = getattr(options, name)
        if isinstance(value, Slot):
            # An option that is called like no kind (`fallback`) holds a plug-in of the same kind.
            inner = name if name in KINDS else kind
            yield from problems_of_slot(host, inner, value, f"{key}.{name}", base_dir, encoder)
