"""The tables that every case has: `[training]`, `[evaluation]` and `[objective]`."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import Field

from .error import CaseError
from .table import CaseTable, Positive, Range, optional, parse

MAX_PATHS = 100_000_000  # more path totals than fit in the memory of one machine
MAX_STEPS = 1_000_000_000  # of training: JAX counts in 32 bits
IN_MEMORY = Range(1, MAX_PATHS, note="; more do not fit in memory")
STEPS = Range(1, noun="a number of steps")
EVERY = STEPS._replace(
    note="; by default 50, 10 for a fitted rule, or a quarter of the steps if they are few"
)
UP_TO_ONE = Range(0, 1, "(]")
PathCount = Annotated[int, IN_MEMORY._replace(low=64)]
MaxPaths = Annotated[
    int, Range(0, MAX_PATHS, note=": the largest number of paths to use; 0 for none")
]


class TrainingTable(CaseTable):
    """`[training]`: how the policy is trained, with the fields of `snapo.Training`."""

    steps: Annotated[int, Range(0, MAX_STEPS)] = 240
    paths: Annotated[int, IN_MEMORY._replace(low=2)] = 512
    learning_rate: Positive = 0.01
    warmup: Annotated[int, STEPS._replace(low=0, high=MAX_STEPS)] = 20
    decay: Annotated[float, Range(0, 1e6)] = 0.0
    temperature_start: Positive = 0.02
    temperature_end: Positive = 0.005
    average: Annotated[float, UP_TO_ONE] = 0.05
    validation_paths: Annotated[int, IN_MEMORY] = 4096
    validation_every: Annotated[int, EVERY] | None = None
    patience: Annotated[int, Range(1, noun="a number of validations")] | None = None
    window: Annotated[int, STEPS] | Literal["auto"] = "auto"
    clip: Positive | Literal["auto"] = "auto"
    keep: Annotated[float, UP_TO_ONE] | Literal["auto"] = "auto"
    spread: Positive = 1.0
    exploration: Annotated[float, Range(0, 1, "[)")] = 0.0
    starts: Annotated[int, Range(1, noun="a number of initial weights")] = 1
    seed: Annotated[int, Range(0, 2**63 - 1)] = 0


@optional(
    "steps", "paths", "learning_rate", "decay", "exploration", "starts",
    note="; by default it is chosen from the problem",
)  # fmt: skip
class FollowingTable(TrainingTable):
    """`[training]` of a plant or of a user-defined simulator: six keys are chosen from the problem.

    They do so where they are left out, as in `snapo.Training`.
    """


@optional("steps", note="; by default 20 if a mean is optimised from a fitted rule, else 240")
@optional(
    "learning_rate",
    note="; by default 0.001 if a mean is optimised from a fitted rule, else 0.01",
)
class FittedTable(TrainingTable):
    """`[training]` of an energy contract, whose policy begins from a fitted value.

    Where that value is fitted to all risks of the prices and the objective is a mean, a few small
    steps test whether training gains anything over it.
    """


AnyTraining = TypeVar("AnyTraining", bound=TrainingTable)


class EvaluationTable(CaseTable):
    """`[evaluation]`: the fresh scenarios on which the exact value is measured.

    `judge_paths`: the paths of the bumps that the derivatives are tested by; `search_paths`: the
    paths of the search around the policy, which gives every interval the policy's part;
    `selection_paths`: the paths of the final choice between the trained policies and the starting
    rule. Each is a maximum; 0 omits the measurement.
    """

    paths: PathCount = 65536
    sensitivity_paths: PathCount = 16384
    judge_paths: MaxPaths = 16384
    search_paths: MaxPaths = 16384
    selection_paths: MaxPaths = 16384
    scenarios: Literal["pseudo-random", "sobol"] = "pseudo-random"


class ObjectiveTable(CaseTable):
    """`[objective]`: the figure to maximise; `kind` determines which of the other keys apply.

    `level`: "cvar" is the mean of the worst 1 - level of the paths. `risk_aversion`: the risk
    aversion of "mean-variance" and "entropic" in 1/currency, of "crra" a pure number. `wealth`:
    currency, added to each path's total under "crra". `target`: currency, the aim of "target".
    """

    kind: Literal["mean", "cvar", "mean-variance", "entropic", "crra", "target"] = "mean"
    level: Annotated[float, Range(0, 1, "()")] | None = None
    risk_aversion: Positive | None = None
    wealth: Positive | None = None
    target: float | None = Field(None, description="a number")

    @property
    def keeps_unit(self) -> bool:
        """Whether the figure has the unit of the output."""
        return self.kind in ("mean", "cvar", "entropic")


OBJECTIVE_KEYS = {
    "mean": (),
    "cvar": ("level",),
    "mean-variance": ("risk_aversion",),
    "entropic": ("risk_aversion",),
    "crra": ("risk_aversion", "wealth"),
    "target": ("target",),
}


def read_objective(
    data: Mapping, file: str, name: str = "objective", optional: tuple[str, ...] = ()
) -> ObjectiveTable:
    """Reads the table `name`, and checks that the keys are those of its kind.

    Keys in `optional` may be left out where other domains need them.
    """
    objective = parse(ObjectiveTable, data, file, name)
    kind = objective.kind
    for key in OBJECTIVE_KEYS[kind]:
        if key not in data and key not in optional:
            raise CaseError(file, f"{name}.{key}", None, f'kind "{kind}" needs this key')
    for key in data:
        if key not in ("kind", *OBJECTIVE_KEYS[kind]):
            owners = [f'"{item}"' for item, keys in OBJECTIVE_KEYS.items() if key in keys]
            message = f'kind "{kind}" has no such key; it belongs to {", ".join(owners)}'
            raise CaseError(file, f"{name}.{key}", data[key], message)
    return objective


def read_weight(data: Mapping, objective: ObjectiveTable, file: str, name: str) -> float:
    """`weight` of one of several objectives that are added up, 1 if it is left out.

    A negative weight turns a risk measure into that of a cost (see `snapo.problem.objective`), but
    not a utility.
    """
    weight = data.get("weight", 1.0)
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not weight:
        raise CaseError(file, f"{name}.weight", weight, "it must be a number other than 0")
    if objective.kind == "crra" and weight < 0:
        message = "a utility is for a quantity to maximise: "
        message += 'with kind "crra" it must be a number above 0'
        raise CaseError(file, f"{name}.weight", weight, message)
    return float(weight)


def read_training(
    data: Mapping, file: str, table: type[AnyTraining] = TrainingTable
) -> AnyTraining:
    """Reads `[training]`; the temperature may only fall."""
    training = parse(table, data, file, "training")
    if training.temperature_end > training.temperature_start:
        where, value = "training.temperature_end", training.temperature_end
        message = f"it must be at most temperature_start, {training.temperature_start:g}"
        raise CaseError(file, where, value, message)
    if training.exploration and training.temperature_end == training.temperature_start:
        where, value = "training.temperature_end", training.temperature_end
        message = (
            "with exploration, which falls with the temperature, it must be below temperature_start"
        )
        raise CaseError(file, where, value, message)
    return training


def check_window(training: TrainingTable, kinds: Iterable[str], file: str) -> None:
    """Refuses training on windows for objectives that have no continuation value."""
    for kind in kinds:
        if training.window != "auto" and kind != "mean":
            message = f'windows need an objective of kind "mean", but this one is "{kind}"'
            raise CaseError(file, "training.window", training.window, message)


def read_evaluation(data: Mapping, file: str) -> EvaluationTable:
    """Reads `[evaluation]`."""
    return parse(EvaluationTable, data, file, "evaluation")
