"""A daily forward curve from quotes of traded products: `products`, `smooth`, `quotes`.

The curve is linear in the quotes, so a delta by day becomes one by quote with the transpose of the
same matrix.
"""
