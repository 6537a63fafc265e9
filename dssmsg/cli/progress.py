"""How far a long command is: a bar on a terminal, plain lines elsewhere; always on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dssmsg.cli.output import plain

Told = Callable[[int, int, str], None]
"""How many are done, of how many, and a line on the latest ("" for none)."""


@contextmanager
def counting() -> Iterator[Told]:
    """Yields what to tell the progress to. The bar goes when the work is over; the lines stay."""
    if not sys.stderr.isatty():
        yield _say
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)

        def tell(done: int, of: int, line: str) -> None:
            bar.update(task, completed=done, total=of)
            if line:
                bar.console.print(plain(line), markup=False, highlight=False)

        yield tell


def _say(done: int, of: int, line: str) -> None:
    if line:
        print(plain(line), file=sys.stderr, flush=True)
