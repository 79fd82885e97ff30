"""The contract core: the interface of a contract, and the simulator and policy of all contracts."""
