"""The work of `snapo solve`: a run made ready, begun with a given policy, or once for each seed."""
