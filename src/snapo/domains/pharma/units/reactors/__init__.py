"""Parts of reactors: their jacket, and what flows along a tube."""
