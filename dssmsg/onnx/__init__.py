"""ONNX models that users bring: opened in one place, told apart by their inputs and outputs, run by adapters.

`session` opens a file, `contracts` is the table of what is known, `matching` holds a file against it, the
other files are one adapter a family. Importing any of them imports neither onnxruntime nor a model.
"""
