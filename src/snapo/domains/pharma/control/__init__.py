"""The process in closed loop: a policy decides from measurements while a batch runs.

`closed_loop` puts the loop together from `stages` and defines its problem; `rules` has the
controllers with which the trained policy is compared.
"""
