"""Seeded cases in which a thing that is still there cannot be seen any more: nobody may call it disappeared.

A case is a home with a tour of one stop; before the second visit a screen stands between the stop and a thing
that the first visit saw. The views of the stop leave other things out of sight as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dssmsg.config_yaml import dump_yaml
from dssmsg.errors import InputError, StorageError
from dssmsg.evaluate.replays import Case, Progress
from dssmsg.sim.camera import make_renderer
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.scenario import generate_scenario
from dssmsg.sim.scenario_views import TourViews
from dssmsg.sim.scene import Scene, load_scene

_COUNTS = {"occluder": 1}


def occlusion_cases(
    work: Path,
    scenes: Sequence[str],
    cases: int,
    perception: str,
    *,
    assets: str = "auto",
    progress: Progress = lambda _line: None,
) -> list[Case]:
    """`cases` cases, spread evenly over the scenes; their scene files are written into the work folder.

    Files that are there are kept. Raises InputError where a scene has no stop to put a screen before.
    """
    folder = work / "occlusion"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be made ({error.strerror})", file=folder) from error
    library: FurnitureLibrary | None = None
    made = []
    for number in range(cases):
        scene, seed = scenes[number % len(scenes)], number // len(scenes)
        file = folder / f"{scene.replace(':', '_').replace('/', '_')}-{assets}-{seed}.yaml"
        if not file.is_file():
            library = library or FurnitureLibrary.open(assets)
            text = dump_yaml(
                screened(load_scene(scene), library, seed).model_dump(mode="json", exclude_none=True)
            )
            draft = file.with_suffix(".tmp")
            draft.write_text(text, "utf-8")
            draft.replace(file)
        made.append(Case(scene, seed, perception, file=file))
        if (number + 1) % 10 == 0:
            progress(f"{number + 1} of {cases} occlusion cases are set up")
    return made


def screened(scene: Scene, library: FurnitureLibrary, seed: int) -> Scene:
    """The scene with a tour of one stop, drawn by the seed, where a screen hides a thing in the second visit.

    Raises InputError where no stop leaves room for one.
    """
    views = TourViews(make_renderer()[0], make_renderer()[0])
    try:
        for index in np.random.default_rng([seed, 0x0CC1]).permutation(len(scene.tour)):
            stop = scene.tour[int(index)].model_copy(update={"via": ()})
            short = Scene.model_validate({**dict(scene), "tour": (stop,), "changes": (), "queries": ()})
            made = generate_scenario(short, library, views, seed=seed, counts=_COUNTS)
            if made.made.get("occluder"):
                return made.scene
    finally:
        views.close()
    raise InputError("has no stop at which a screen hides a single thing", file=scene.name, key="tour")
