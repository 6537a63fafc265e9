"""What the tour of a small home will show, known before anybody drives: which goals are worth asking for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from dssmsg.evaluate.visible import MIN_PIXELS
from dssmsg.sim.camera import make_renderer
from dssmsg.sim.scenario_views import HALF, TourViews
from dssmsg.sim.scene import Scene
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placed, Placer
from dssmsg.sim.script import visit_states
from dssmsg.sim.tour import tour_of
from dssmsg.sim.visibility import FULL_WIDTH

_MARGIN = 1.3
"""Some more pixels than must be: poses of the drive are not quite those of the tour."""


@contextmanager
def opened_views() -> Iterator[TourViews]:
    """Two renderers for as long as they are needed."""
    views = TourViews(make_renderer()[0], make_renderer()[0])
    try:
        yield views
    finally:
        views.close()


@dataclass(frozen=True, slots=True)
class Shown:
    """What a tour shows well. `shares`: name of each such piece -> the share of the views that show it, 0..1.

    `last`: those that the last stop shows, where the robot stands when the tour is over.
    """

    shares: Mapping[str, float]
    last: frozenset[str]


def shown_by(views: TourViews, scene: Scene, placer: Placer, visit: int, image_width: int) -> Shown:
    """What the tour of a visit, of a home as that visit finds it, shows.

    `image_width` is that of the episodes' images, pixels: the fewer there are, the nearer a thing must be.
    """
    state: Mapping[str, Placed] = placer.initial() if visit == 0 else visit_states(scene, placer, visit)[0]
    need = _MARGIN * MIN_PIXELS * (FULL_WIDTH / HALF / image_width) ** 2
    tour = tour_of(scene, visit)
    shots = views.take(tour, build_layout(scene), state.values())
    seen = {
        name: [shot.stop for shot in shots if shot.pixels.get(piece.instance_id, 0) >= need]
        for name, piece in state.items()
    }
    return Shown(
        {name: len(stops) / len(shots) for name, stops in seen.items() if stops},
        frozenset(name for name, stops in seen.items() if tour[-1].name in stops),
    )
