"""The terms of a storage contract as records, and the contract as a simulator of one path.

`records.StorageCase` is a case after reading, `simulator.simulator_of` returns the simulator of a
problem. `feasibility` has the inventories from which all obligations can be met, day by day.
"""
