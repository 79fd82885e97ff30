"""Gas storage: values and operates a contract on gas in store. Importing this module loads little
else."""

from snapo.study.kind import Kind

DOMAIN = Kind(
    "gas-storage",
    "a gas storage contract: value, deltas, trigger prices",
    __name__,
    {"flagship": "template"},
    summary="summary:lines",
    timer="bench:bench",
    explainer="explain.parts:explained_change",
)
