"""A bound from above for a fund: no policy's expected utility of the funding ratio is higher."""
