"""The inner problem of `snapo.bound` for every simulator with a `Stop`, without help from its user.

`stop.relaxation_of` makes it; its penalties come from the value that `value.fit` regresses.
"""
