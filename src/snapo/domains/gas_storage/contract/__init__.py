"""The terms of a storage contract as records, and the contract as a simulator of one path.

`records.StorageCase` is a case that was read, `simulator.simulator_of` its simulator. `feasibility`
has the inventories from which all obligations can be met, day by day.
"""
