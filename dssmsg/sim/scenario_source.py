"""The scene that a simulated run drives through: the scene of its options, with the changes they ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dssmsg.sim.camera import make_renderer
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.robot import RobotSpec
from dssmsg.sim.scenario import generate_scenario
from dssmsg.sim.scenario_views import TourViews
from dssmsg.sim.scene import Scene, load_scene

GENERATED = "generated:"


@dataclass(frozen=True, slots=True, eq=False)
class ScriptedScene:
    """A scene and its furniture; `note` says in one line which changes happen in it."""

    scene: Scene
    library: FurnitureLibrary
    note: str


def scripted_scene(
    name: str,
    *,
    assets: str = "auto",
    changes: str = "script",
    counts: Mapping[str, int] | None = None,
    visits: int = 2,
    renderer: str = "auto",
    robot: RobotSpec | None = None,
    base_dir: Path | None = None,
) -> ScriptedScene:
    """What the options of the same names of the source `pybullet` come to.

    `changes` is `script`, `none` or `generated:<seed>`; with `none` the script stays in the scene,
    unheeded. What `robot` sees decides where generated changes are made.
    Raises ConfigError and InputError as `load_scene`, `FurnitureLibrary.open` and `make_renderer` do.
    """
    scene = load_scene(name, base_dir=base_dir)
    library = FurnitureLibrary.open(assets)
    if not changes.startswith(GENERATED):
        return ScriptedScene(scene, library, "none" if changes == "none" else "the scene's script")
    views = TourViews(make_renderer(renderer)[0], make_renderer(renderer)[0], robot)
    try:
        seed = int(changes.removeprefix(GENERATED))
        made = (
            generate_scenario(scene, library, views, seed=seed, visits=visits)
            if counts is None
            else generate_scenario(scene, library, views, seed=seed, counts=counts, visits=visits)
        )
    finally:
        views.close()
    return ScriptedScene(made.scene, library, made.note())
