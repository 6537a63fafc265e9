"""What the scene graph says when it refuses a change."""

from __future__ import annotations

from dssmsg.errors import DssmsgError


class GraphError(DssmsgError):
    """A change does not fit the graph: the plug-in that made it is wrong, the graph is left as it was.

    `change` is the change's kind, `subject` its main id (or edge), `expected` and `got` what disagreed.
    """

    kind = "graph"
    exit_code = 1

    def __init__(self, change: str, subject: str, *, expected: str, got: str) -> None:
        super().__init__(f"{change} {subject}: expected {expected}, got {got}")
        self.change = change
        self.subject = subject
        self.expected = expected
        self.got = got
