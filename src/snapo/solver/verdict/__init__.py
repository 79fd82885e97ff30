"""How a training ended: `convergence.ending` gives the keyword and reasons for distrust.

`further` extrapolates the gain of more steps, and `constant` compares the policy with decisions
that never change.
"""
