"""One path of a pension fund: the market moves, members are paid and the fund rebalances.

`simulator.PensionSimulator` makes the step. Its rules (contributions, indexation, trading,
collateral) are in separate files, and `schedule` has the numbers that all paths share.
"""
