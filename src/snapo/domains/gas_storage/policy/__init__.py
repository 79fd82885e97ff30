"""The decision rule: its value table, its observation, its network, and the decisions that follow.

`network.StoragePolicy` corrects the marginal value of gas that `value_table` takes from a dynamic
program; `triggers` reads prices and today's decision off the trained policy.
"""
