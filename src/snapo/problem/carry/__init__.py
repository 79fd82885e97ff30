"""Exports a policy as a file that describes itself, an ONNX graph, or a table of decisions.

`save` implements `policy.save` and `load_policy`. `export` implements `to_onnx` and
`decision_table`, with one entry of `rules` for each operation of a trace.
"""
