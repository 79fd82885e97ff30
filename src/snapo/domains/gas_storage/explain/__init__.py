"""The change of value between two runs of a gas store, in parts: `snapo explain`."""
