"""Colours and class ids of everything the viewer shows. Said once, logged once."""

from __future__ import annotations

import rerun as rr

from dssmsg.graph.nodes import APPEARED, BELIEVED, DISAPPEARED, MOVED, NEAR, PATH, SEES, STATIC, ObjectNode

Colour = tuple[int, int, int]

TENTATIVE_CLASS = 1
OBJECT_CLASSES: dict[str, tuple[int, str, Colour]] = {
    "tentative": (TENTATIVE_CLASS, "tentative", (95, 100, 110)),
    STATIC: (2, "static", (120, 175, 255)),
    APPEARED: (3, "appeared", (80, 220, 120)),
    DISAPPEARED: (4, "disappeared", (240, 80, 80)),
    MOVED: (5, "moved", (255, 165, 60)),
    "history": (6, "former place", (190, 120, 220)),
}
"""Class id, name and colour by status and dynamic state."""

EDGE_COLOURS: dict[str, tuple[int, ...]] = {
    PATH: (90, 220, 160),
    SEES: (58, 55, 44),  # there are many: just above the background; `SEEN_NOW_COLOUR` for those that matter
    NEAR: (160, 160, 172),  # not blue: lines between boxes, most of which are
    "blocked": (240, 70, 70),
}
SEEN_NOW_COLOUR: Colour = (235, 200, 90)
WAYPOINT_COLOUR: Colour = (90, 220, 160)
PLOT_COLOURS: dict[str, Colour] = {
    "objects/believed": OBJECT_CLASSES[STATIC][2],
    "objects/tentative": (170, 175, 185),
    "objects/waypoints": WAYPOINT_COLOUR,
}
"""By the path of the plot below `/plots`; the viewer chooses for the others."""
VIEWPOINT_COLOUR: Colour = (150, 200, 175)
ROBOT_COLOUR: Colour = (245, 245, 245)
TRAIL_COLOUR: Colour = (250, 130, 200)
NAV_PATH_COLOUR: Colour = (255, 255, 255)
GOAL_COLOUR: Colour = (255, 215, 90)
FOCUS_COLOUR: Colour = (255, 255, 255)

CHANGE_COLOURS: dict[str, Colour] = {
    "object_added": (80, 220, 120),
    "object_merged": (150, 155, 165),
    "objects_joined": (190, 150, 255),
    "object_changed": (120, 175, 255),
    "object_replaced": (255, 165, 60),
    "object_removed": (240, 80, 80),
    "waypoint_added": (90, 220, 160),
    "waypoint_removed": (240, 80, 80),
    "viewpoint_added": (150, 200, 175),
    "viewpoint_seen": (130, 135, 145),
    "edge_added": (235, 200, 90),
    "edge_changed": (235, 200, 90),
    "edge_removed": (240, 120, 80),
}

DETECTION_COLOURS: tuple[Colour, ...] = (
    (255, 99, 99),
    (99, 200, 255),
    (140, 230, 110),
    (255, 190, 80),
    (205, 130, 255),
    (90, 230, 200),
    (255, 140, 200),
    (230, 230, 110),
)
"""Told in turn to the detections of a frame, so that a mask and its box match."""

STATE_COLOURS: dict[str, Colour] = {
    "survey": (80, 130, 220),
    "revisit": (90, 200, 150),
    "seek": (240, 160, 70),
    "look": (120, 175, 255),
    "turn": (190, 150, 255),
    "drive": (90, 220, 160),
    "detour": (255, 165, 60),
    "replan": (240, 110, 80),
    "arrived": (80, 220, 120),
    "blocked": (240, 70, 70),
    "inspect": (235, 200, 90),
    "seen": (40, 180, 90),
    "done": (150, 155, 165),
}


def object_class(node: ObjectNode) -> int:
    """The class id of an object: tentative, or its dynamic state."""
    kind = node.state if node.status == BELIEVED else "tentative"
    return OBJECT_CLASSES.get(kind, OBJECT_CLASSES[STATIC])[0]


def world_annotations() -> rr.AnnotationContext:
    """Names and colours of the object classes."""
    return rr.AnnotationContext(
        [
            rr.AnnotationInfo(id=number, label=name, color=colour)
            for number, name, colour in OBJECT_CLASSES.values()
        ]
    )


def state_configuration() -> rr.StateConfiguration:
    """Colours of phases and of the driver's states in the state timeline."""
    return rr.StateConfiguration(values=list(STATE_COLOURS), colors=list(STATE_COLOURS.values()))


def detection_class(index: int) -> int:
    """The class id of a frame's detection; 0 is the background."""
    return 1 + index % len(DETECTION_COLOURS)


def camera_annotations() -> rr.AnnotationContext:
    """Colours of a frame's detections, below the camera."""
    background = rr.AnnotationInfo(id=0, label="", color=(0, 0, 0, 0))
    return rr.AnnotationContext(
        [background]
        + [rr.AnnotationInfo(id=1 + number, color=colour) for number, colour in enumerate(DETECTION_COLOURS)]
    )
