"""What `snapo check` prints of a case of control: nothing is compiled."""

from snapo.problem.inputs import named_inputs

from .records import ControlCase, unit


def lines(case: ControlCase) -> list[str]:
    """The case in a few lines."""
    plant, numbers = case.plant, [item.input.value.size for item in named_inputs(case.inputs)]
    states = ", ".join(f"{name} ({unit(state.unit)})" for name, state in plant.states.items())
    actions = ", ".join(f"{name} ({unit(action.unit)})" for name, action in plant.actions.items())
    return [
        f"{case.title}: {plant.description}",
        f"{plant.horizon} steps; states {states}; actions {actions}",
        f"{len(numbers)} inputs with {sum(numbers)} numbers, each with a sensitivity",
        f"the {case.objective_words} is maximised",
    ]
