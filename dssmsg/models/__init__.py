"""Models that the project does not ship but can get: catalogue, download, conversion to ONNX, cache."""
