"""A policy on its way out: a file that describes itself, an ONNX graph, a table of decisions."""
