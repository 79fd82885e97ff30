"""One path of a pension fund: the market moves, members are paid and the fund rebalances.

`simulator.PensionSimulator` makes the step; the rules that it follows (contributions, indexation,
trading, collateral) have a file each, and `schedule` the numbers that all paths share.
"""
