"""A daily forward curve from quotes of traded products: `products`, `smooth`, `quotes`.

The curve is linear in the quotes. The transpose of its matrix therefore turns deltas by day into
deltas by quote.
"""
