"""From a problem to a `Solution`: trained, measured on fresh paths, and differentiated.

`solve.solve` is the entry point. `train` makes the steps with the settings and remedies of
`learning`, `measure` selects the policy and its value, `derivatives` has the intervals, and
`verdict` has reasons to distrust them. `evaluate`, `sensitivity`, `certificate` and `bound` work on
any policy by themselves.
"""
