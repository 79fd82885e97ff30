"""From a jaxpr to straight-line programs of typed arrays, and their division in two sweeps.

`cut` traces a function and cuts it by dependence, `flatten` makes a `Program` of each piece,
`passes` simplify it, and `sweeps` plans which numbers the transpose finds on the tape.
"""
