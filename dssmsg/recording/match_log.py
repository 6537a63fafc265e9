"""What the viewer shows of a grounded query: its candidates' scores as bars and as a matrix."""

from __future__ import annotations

import numpy as np
import rerun as rr

from dssmsg import events
from dssmsg.recording import schema
from dssmsg.recording.sheets import SheetBook, Stamp, path_part

_LONGEST = 40
"""Characters of a sentence that go into its path."""


class MatchLog:
    """Logs `/scores/<query>` (a bar a candidate, best first) and `/matrix/<query>` (candidate x score).

    A query's path is its number and its words. What the one before it left in the views is cleared, so that a
    view shows the latest up to the cursor.
    """

    def __init__(self, book: SheetBook) -> None:
        self._book = book
        self._queries = 0
        self._shown = ""

    def add(self, event: events.Matched, stamp: Stamp) -> None:
        """Show the candidates of a query; nothing is drawn for none."""
        if self._shown:
            for root in (schema.SCORES, schema.MATRIX):
                self._book.log_now(f"{root}/{self._shown}", stamp, rr.Clear(recursive=False))
            self._shown = ""
        self._queries += 1
        if not event.candidates:
            return
        words = path_part(event.query.replace("/", " "))[:_LONGEST].strip("_")
        self._shown = f"{self._queries:03d}_{words}"
        names = list(dict.fromkeys(name for one in event.candidates for name in one.scores))
        table = np.array(
            [[one.scores.get(name, np.nan) for name in names] for one in event.candidates], dtype=np.float64
        )
        if not table.size:
            return
        ranked_by = names.index("score") if "score" in names else 0
        bars = np.nan_to_num(table[:, ranked_by])
        self._book.log_now(f"{schema.SCORES}/{self._shown}", stamp, rr.BarChart(bars))
        matrix = rr.Tensor(np.nan_to_num(table).astype(np.float32), dim_names=("candidate", " ".join(names)))
        self._book.log_now(f"{schema.MATRIX}/{self._shown}", stamp, matrix)
