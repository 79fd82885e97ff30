"""The domain: a shop that orders every day before it knows the demand.

Light, so that `snapo new` answers at once; the rest is imported when it is needed.
"""

from snapo.study.kind import Kind

DOMAIN = Kind(
    "newsvendor",
    "orders for a shop with uncertain demand",
    __name__,
    {"shop": "template"},
    reader="study:read_case",
    page="study:REPORT",
)
