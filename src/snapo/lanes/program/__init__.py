"""From a jaxpr to straight-line programs of typed arrays, and their division in two sweeps."""
