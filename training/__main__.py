"""`python -m training STAGE`; each stage resumes where it was stopped, see README.md."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

MASKS = ("masks", "masks2", "masks3", "masks4", "masks5", "masks6")
STAGES = ("render", *MASKS, "crops", "proposals", "tune", "export", "calibrate")
SEEDS = (*range(540), *range(600, 1000))


def main() -> None:
    """Parse and run one stage, or all of them in order."""
    parser = argparse.ArgumentParser(prog="python -m training", description=__doc__)
    parser.add_argument("stage", choices=[*STAGES, "all"])
    parser.add_argument("--work", type=Path, default=Path("training/work"), help="shards and checkpoints")
    parser.add_argument("--weights", type=Path, default=Path("dssmsg/data/weights"), help="where networks go")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--part", type=int, default=0, help="render: this process's share of --parts")
    parser.add_argument("--parts", type=int, default=1)
    parser.add_argument("--steps", type=int, default=None, help="masks, crops, tune: instead of the plan's")
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", str(given.threads))
    for stage in STAGES if given.stage == "all" else (given.stage,):
        print(f"stage {stage}", flush=True)
        run(stage, given)


def run(stage: str, given: argparse.Namespace) -> None:
    """One stage; what only it needs is imported here."""
    work: Path = given.work
    shards = work / "shards"
    masks, crops, tuned = (work / f"{name}.pt" for name in (MASKS[-1], "crops", "tuned"))
    if stage == "render":
        from training.render import render

        render(shards, SEEDS, part=given.part, parts=given.parts)
        return
    import torch

    torch.set_num_threads(given.threads)
    if stage in MASKS:
        from training.masks import ROUNDS, train

        number = MASKS.index(stage)
        before = work / f"{MASKS[number - 1]}.pt" if number else None
        train(shards, work / f"{stage}.pt", planned(ROUNDS[number], given.steps), begin_with=before)
    elif stage == "crops":
        from training import crops_train

        crops_train.train(shards, crops, planned(crops_train.Plan(), given.steps))
    elif stage == "proposals":
        from training.export import calibrate, export
        from training.proposals import propose

        export(masks, crops, work / "weights")
        calibrate(work / "weights")  # joining must be known
        propose(shards, work / "weights", work / "proposals")
    elif stage == "tune":
        from training import crops_train

        plan = planned(crops_train.TUNING, given.steps)
        crops_train.train(shards, tuned, plan, begin_with=crops, proposals=work / "proposals")
    elif stage == "export":
        from training.export import export

        export(masks, tuned if tuned.exists() else crops, given.weights)
    else:
        from training.export import calibrate

        calibrate(given.weights)


def planned(plan: Any, steps: int | None) -> Any:
    """The stage's plan, of another length where that was asked for."""
    if steps is None:
        return plan
    shorter = {"steps": steps, "until": steps} if hasattr(plan, "until") else {"steps": steps}
    return replace(plan, **shorter)


if __name__ == "__main__":
    main()
