"""Material from unit to unit: streams, the order of the flow, and the flowsheet as a function.

`process.PharmaProcess` is that function, from the inputs of a `case.PharmaCase` to its quality
attributes; `flow` goes through the units, and `recycle` closes their loops.
"""
