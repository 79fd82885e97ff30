"""The terms of a storage contract as records, and the contract as a simulator of one path."""
