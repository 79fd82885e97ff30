"""The change of value between two runs of a contract, in parts: `snapo explain`."""
