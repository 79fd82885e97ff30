"""The parts of a run by name, and those that the run of a case cannot have."""

from .case import PensionCase

PARTS = (
    "reconciliation", "stress", "training", "objective", "paths", "today", "sensitivities",
    "outputs", "certificate", "attribution", "variance by source", "market consistency",
    "classical policies", "frontier", "pots",
)  # fmt: skip
# Parts of promised rights only; a fund of pots has its own part.
OF_RIGHTS = ("attribution", "variance by source", "market consistency", "frontier")
# What moves or replaces the numbers of the models.
OF_MODELS = ("variance by source", "market consistency")


def missing_parts(case: PensionCase, stress: bool) -> dict[str, str]:
    """{part: why a run of the case has it not, or has nothing in it}; `stress`: whether the case
    names a file of shocks."""
    result = {} if stress else {"stress": "the case has no [stress]"}
    if case.frontier is None:
        result["frontier"] = "the case has no [frontier]"
    if case.scenarios is not None:
        result |= dict.fromkeys(OF_MODELS, "ready-made [scenarios] replace the models")
    if case.pots is None:
        result["pots"] = "the case has no [pots]"
    else:
        result |= dict.fromkeys(OF_RIGHTS, "it is of promised rights, and this fund has [pots]")
    return result
