"""All that inputs say about themselves, as the report reads it."""

from typing import Any

from snapo.problem.inputs import Input


def described(inputs: dict[str, Input]) -> dict[str, dict[str, Any]]:
    """{name: words, group, unit, the unit of the trade, and the usual move}."""
    return {
        name: {
            "words": each.words,
            "group": each.group,
            "unit": each.unit,
            "move": each.move,
            "trade_unit": each.trade_unit,
            "trade_factor": each.trade_factor,
        }
        for name, each in inputs.items()
    }
