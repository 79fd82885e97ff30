"""Several places that supply one another: a line, or one warehouse with several stores.

`simulator.NetworkSimulator` is one path of a `records.NetworkCase`; `policy` has the trained rule,
`rules` the classical ones.
"""
