"""The decision rule: its guide, its observation, its network, and the decisions that follow."""
