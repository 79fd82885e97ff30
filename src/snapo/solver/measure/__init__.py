"""After training: the policy that is reported, and its value on fresh paths.

`selection.select` chooses among those that a training leaves; `measure.measure` has value, limits
and derivatives of the one that it chose.
"""
