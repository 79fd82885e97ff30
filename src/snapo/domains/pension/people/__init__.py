"""Members of a fund: their survival, their expected payments, and the value of these.

`cash_flows.project` makes expected payments by step, once for all paths; `liability` values them on
the curve of each path.
"""
