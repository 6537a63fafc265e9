"""What the recogniser may be trained on: furniture models by label, and the split into known and held out."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import yaml

from dssmsg.errors import ConfigError, InputError
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.furniture.categories import load_categories
from dssmsg.sim.furniture.catalogue import Entry, cache_key, convert
from dssmsg.sim.furniture.library import find_entries
from dssmsg.sim.furniture.cache import MeshCache
from dssmsg.sim.mesh import Mesh

TABLE = "data/weights/models.yaml"
