"""Parts of reactors: their jacket, and the flow along a tube."""
