"""Furniture to put into scenes: real pieces of the Sweet Home 3D libraries, or primitives of our own."""

from dssmsg.sim.furniture.library import FurnitureLibrary, furniture_folders
from dssmsg.sim.furniture.model import FurnitureModel

__all__ = ["FurnitureLibrary", "FurnitureModel", "furniture_folders"]
