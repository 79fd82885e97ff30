"""After training: the policy that is reported, and its value on fresh paths.

`selection.select` chooses among the policies of a training; `measure.measure` computes value,
limits and derivatives of the selected one.
"""
