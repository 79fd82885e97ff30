"""The contract core: what a contract tells it, and the simulator and policy of all of them."""
