"""The unit operations, one file for each; `registry` has the list of them.

A new unit is an `operation.Unit`: its table, ports, equations, balances and measures.
"""
