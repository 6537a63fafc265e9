"""A detector of one's own: colourful spots. Use it with `perception: {use: my_detector}`."""

from pydantic import Field
from scipy import ndimage

from dssmsg.frame import Detection
from dssmsg.hookspecs import PluginConfig, hookimpl


class Config(PluginConfig):
    colourful: int = Field(80, ge=1, le=255, description="Least difference of a pixel's colours.")
    min_pixels: int = Field(200, ge=16, description="Smaller spots are left out.")


class MyDetector:
    feature_space = None  # its detections carry no feature vectors

    def __init__(self, config, context):
        self.config = config

    def detect(self, frame):
        colourful = frame.rgb.max(axis=2) - frame.rgb.min(axis=2) >= self.config.colourful
        spots, _ = ndimage.label(colourful & (frame.depth > 0))
        found = []
        for number, (rows, columns) in enumerate(ndimage.find_objects(spots), 1):
            mask = spots == number
            if mask.sum() >= self.config.min_pixels:
                box = (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
                found.append(Detection(mask, box, label="spot", score=0.6))
        return found


@hookimpl
def register_perception(register):
    register("my_detector", MyDetector, config=Config)
