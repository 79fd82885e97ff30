"""Pharmaceutical processes: flowsheets of unit operations, from feeds to quality."""

from snapo.study.kind import Kind

DOMAIN = Kind(
    "pharma",
    "a pharmaceutical process: sensitivities, design space, best recipe, closed loop",
    __name__,
    {"standard": "template"},
    reader="read.case:resolve",
    summary="summary:lines",
    timer="bench:bench",
    relaxed="read.case:without_checks",
)
