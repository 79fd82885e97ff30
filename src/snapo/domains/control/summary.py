"""The text that `snapo check` prints for a case of control; nothing is compiled."""

from snapo.study.kind import inputs_line

from .inputs import flat
from .records import ControlCase, unit


def lines(case: ControlCase) -> list[str]:
    """The case in a few lines."""
    plant, sizes = case.kind, [entry.value.size for _, entry in flat(case.inputs)]
    states = ", ".join(f"{name} ({unit(state.unit)})" for name, state in plant.states.items())
    actions = ", ".join(f"{name} ({unit(action.unit)})" for name, action in plant.actions.items())
    return [
        f"{case.title}: {plant.description}",
        f"{case.horizon or plant.steps} steps; states {states}; actions {actions}",
        inputs_line(sizes),
        f"the {case.objective_words} is maximised",
    ]
