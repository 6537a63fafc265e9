"""dssmsg: dynamic 3D scene graphs with spatio-semantic memory, logged and inspectable."""

__version__ = "0.1.0"
