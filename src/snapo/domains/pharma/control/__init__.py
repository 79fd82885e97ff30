"""The process in closed loop: a policy decides from measurements while a batch runs.

`loop.closed_loop` puts it together from `stages`; `closed_loop` is its problem, and `rules` has the
controllers with which the trained policy is compared.
"""
