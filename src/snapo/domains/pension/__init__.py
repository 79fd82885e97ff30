"""Pension funds: at every step the weights of the assets and the swaps are decided against the
liabilities."""

from snapo.study.kind import Kind

DOMAIN = Kind(
    "pension",
    "a pension fund that rebalances against its liabilities",
    __name__,
    {size: f"templates/{size}" for size in ("small", "medium", "large", "wtp")},
    reader="read.case:resolve",
    summary="results.figures.lines:lines",
    maker="results.study:pension_study",
    page="report:REPORT",
    tables="read.case:SCHEMA",
)
