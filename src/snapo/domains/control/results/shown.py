"""The reward of an episode and its costs by part, as the live page shows them."""

from collections.abc import Sequence

from snapo.study.study import Measured, Shown

COLUMNS = (("", ""), ("mean of an episode", ""), ("± standard error", ""))
ENDING = "_cost"


def reward_and_costs(found: Measured) -> Sequence[Shown]:
    """The reward, and what every state and action costs."""
    names = [name for name in found.totals if name.endswith(ENDING)]
    costs = [(_words(name), *found.mean(found.totals[name])) for name in names]
    costs.sort(key=lambda row: -row[1])
    rows = [("reward", *found.mean(found.totals["reward"])), *costs]
    return [Shown("Reward and costs by part", COLUMNS, rows)]


def _words(name: str) -> str:
    return "cost of " + name.removesuffix(ENDING).replace("_", " ")
