"""Parts of reactors: the flow along a tube."""
