"""The decision rule: its guide, its observation, its network, and the decisions that follow.

`network.StoragePolicy` corrects the marginal value of gas that `guide` takes from a dynamic
program; `triggers` reads prices and today's decision off the trained policy.
"""
