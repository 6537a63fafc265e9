"""Every figure that the project promises, measured: `make verify`.

    python benchmarks/verify.py [--only NAME ...] [--fresh | --reuse] [--list]

Each measurement is a stage that leaves `benchmarks/results/verify/<stage>.json`; a stage that was measured
on this very code is not repeated, so a run that was cut goes on where it stopped. At the end one table of
everything, with the commit that each figure was measured at.
Exit code 1 if a promise does not hold.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import eyes
import goals
import homes
import inspector
import spine
from staging import ROOT, Row, code_hash

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results" / "verify"


STAGES: dict[str, Callable[[Path], list[Row]]] = {
    **spine.STAGES,
    **eyes.STAGES,
    **homes.STAGES,
    **goals.STAGES,
    **inspector.STAGES,
}


def main() -> int:
    """Run what is missing, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=STAGES, help="these stages alone")
    parser.add_argument("--fresh", action="store_true", help="measure again what is already there")
    parser.add_argument("--reuse", action="store_true", help="take stages measured on other code, too")
    parser.add_argument("--list", action="store_true", help="list the stages")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table as Markdown too")
    options = parser.parse_args()
    if options.list:
        for name, stage in STAGES.items():
            print(f"{name:17} {(stage.__doc__ or '').splitlines()[0]}")
        return 0
    RESULTS.mkdir(parents=True, exist_ok=True)
    wanted = options.only or list(STAGES)
    for name in wanted:
        file = RESULTS / f"{name}.json"
        if file.exists() and not options.fresh:
            stored = json.loads(file.read_text())
            if options.reuse or stored.get("code") == code_hash():
                continue
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        folder = Path(tempfile.mkdtemp(prefix="dssmsg-verify-"))
        try:
            start = time.monotonic()
            rows = [asdict(row) for row in STAGES[name](folder)]
            seconds = round(time.monotonic() - start, 1)
            done = {"code": code_hash(), "commit": commit(), "seconds": seconds, "rows": rows}
            file.write_text(json.dumps(done, indent=1) + "\n")
        finally:
            os.chdir(ROOT)
            shutil.rmtree(folder, ignore_errors=True)
    stages = [json.loads((RESULTS / f"{name}.json").read_text()) for name in wanted]
    if options.write is not None:
        options.write.write_text(markdown(stages))
    return print_table([Row(**row) for stage in stages for row in stage["rows"]])


def commit() -> str:
    """The commit of the checkout, `+` where files were changed since."""
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty=+", "--abbrev=8"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or "unknown"


def markdown(stages: list[dict]) -> str:
    """The table as a page of the documentation."""
    marks = {True: "holds", False: "**fails**", None: "reported"}
    lines = [
        f"| {row['what']} | {row['asked']} | {row['measured']} | {marks[row['holds']]} | {stage['commit']} |"
        for stage in stages
        for row in stage["rows"]
    ]
    machine = f"{os.cpu_count()} {platform.machine()} cores, Python {platform.python_version()}"
    return "\n".join(
        [
            "# Figures",
            "",
            f"Measured by `make verify` on {machine}, {datetime.date.today()}. Timings are noisy: ratios",
            "come from runs in turn. The last column is the commit that a figure was measured at.",
            "",
            "| what | asked | measured | | at |",
            "|---|---|---|---|---|",
            *lines,
            "",
        ]
    )


def print_table(rows: list[Row]) -> int:
    """One table of all results; 1 if a promise does not hold."""
    width = max(len(row.what) for row in rows)
    asked = max(len(row.asked) for row in rows)
    for row in rows:
        mark = {True: "holds", False: "FAILS", None: "-"}[row.holds]
        print(f"{row.what:{width}}  {row.asked:{asked}}  {mark:5}  {' '.join(row.measured.split())}")
    return int(any(row.holds is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
