"""The decision rule: its value table, its observation, its network, and its decisions.

`network.StoragePolicy` corrects the marginal value of gas that `value_table` takes from a dynamic
program; `triggers` has the trigger prices and the decision of today under the trained policy.
"""
