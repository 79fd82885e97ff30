"""The tables that every case has: `[training]`, `[evaluation]` and `[objective]`."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, TypeVar

from .error import CaseError
from .table import CaseTable, Positive, Range, doc, optional, parse, subtable

MAX_PATHS = 100_000_000  # more path totals than fit in the memory of one machine
MAX_STEPS = 1_000_000_000  # of training: JAX counts in 32 bits
IN_MEMORY = Range(1, MAX_PATHS, note="; more do not fit in memory")
STEPS = Range(1, noun="a number of steps")
EVERY = STEPS._replace(
    note="; by default 50, or 10 after a fitted rule, and at most a quarter of the steps"
)
UP_TO_ONE = Range(0, 1, "(]")
ObjectiveKey = Annotated[
    dict[str, Any], subtable("statistic of the paths that is maximised", "objective", {})
]
TrainingKey = Annotated[dict[str, Any], subtable("how the policy is trained", "training", {})]
EvaluationKey = Annotated[dict[str, Any], subtable("how the policy is valued", "evaluation", {})]
PathCount = Annotated[int, IN_MEMORY._replace(low=64)]
MaxPaths = Annotated[
    int, Range(0, MAX_PATHS, note=": the largest number of paths to use; 0 for no such paths")
]


class TrainingTable(CaseTable):
    """`[training]`: how the policy is trained, with the fields of `snapo.Training`."""

    steps: Annotated[int, Range(0, MAX_STEPS)] = doc("training steps", 240)
    paths: Annotated[int, IN_MEMORY._replace(low=2)] = doc(
        "number of fresh paths in a training step", 512
    )
    learning_rate: Positive = doc("peak learning rate of the optimiser, Adam", 0.01)
    warmup: Annotated[int, STEPS._replace(low=0, high=MAX_STEPS)] = doc(
        "number of steps in which the learning rate rises from zero to its peak", 20
    )
    decay: Annotated[float, Range(0, 1e6)] = doc(
        "decay of the weights in a step, as a multiple of the learning rate", 0.0
    )
    temperature_start: Positive = doc(
        "temperature (width of the smoothing) of the rules at the first step", 0.02
    )
    temperature_end: Positive = doc(
        "temperature of the smoothed rules in the last quarter of the steps", 0.005
    )
    average: Annotated[float, UP_TO_ONE] = doc(
        "share of the steps over which the policy is averaged", 0.05
    )
    validation_paths: Annotated[int, IN_MEMORY] = doc(
        "number of fresh paths in a validation, which measures the exact value and selects the "
        "best policy",
        4096,
    )
    validation_every: Annotated[int, EVERY] | None = doc(
        "number of steps between two validations", None
    )
    patience: Annotated[int, Range(1, noun="a number of validations")] | None = doc(
        "number of validations without a new best value after which training stops; by default it "
        "never stops early",
        None,
    )
    window: Annotated[int, STEPS] | Literal["auto"] = doc(
        "number of steps in a window of backpropagation; a critic estimates the value after the "
        "window",
        "auto",
    )
    clip: Positive | Literal["auto"] = doc("bound on the adjoint of a path at every step", "auto")
    keep: Annotated[float, UP_TO_ONE] | Literal["auto"] = doc(
        "share of the adjoint of a path that is passed from a step to the one before", "auto"
    )
    spread: Positive = doc(
        "factor by which the spread of initial states is enlarged, in training only", 1.0
    )
    exploration: Annotated[float, Range(0, 1, "[)")] = doc(
        "share of each decision that is drawn at random in training; the share falls with the "
        "temperature",
        0.0,
    )
    starts: Annotated[int, Range(1, noun="a number of initial networks")] = doc(
        "number of initial networks with which training begins; it continues with the better ones",
        1,
    )
    seed: Annotated[int, Range(0, 2**63 - 1)] = doc("seed of initial weights and scenarios", 0)


@optional(
    "steps", "paths", "learning_rate", "decay", "exploration", "starts",
    note="; by default it is chosen from the problem",
)  # fmt: skip
class FollowingTable(TrainingTable):
    """`[training]` of a plant or a user-defined simulator: six keys have values chosen from the
    problem. These values apply if the keys are omitted, as in `snapo.Training`.
    """


@optional("steps", note="; by default 20 if a mean is optimised from a fitted rule, else 240")
@optional(
    "learning_rate",
    note="; by default 0.001 if a mean is optimised from a fitted rule, else 0.01",
)
class FittedTable(TrainingTable):
    """`[training]` of an energy contract, whose policy begins from a fitted value function.

    If this function is fitted to all risks of the prices and the objective is a mean, a few small
    steps test whether training gains anything.
    """


AnyTraining = TypeVar("AnyTraining", bound=TrainingTable)


class EvaluationTable(CaseTable):
    """`[evaluation]`: the fresh scenarios on which the exact value is measured."""

    paths: PathCount = doc("number of fresh paths on which the policy is valued", 65536)
    sensitivity_paths: PathCount = doc("number of paths for the sensitivities", 16384)
    judge_paths: MaxPaths = doc("number of paths for the bumps that test the derivatives", 16384)
    search_paths: MaxPaths = doc(
        "number of paths in the search around the policy, which measures the policy's part of "
        "every interval",
        16384,
    )
    selection_paths: MaxPaths = doc(
        "number of paths in the final choice between the trained policies and the starting rule",
        16384,
    )
    scenarios: Literal["pseudo-random", "sobol"] = doc(
        "kind of random numbers in the valuation", "pseudo-random"
    )


class ObjectiveTable(CaseTable):
    """`[objective]`: the statistic to maximise; `kind` determines which of the other keys apply."""

    kind: Literal["mean", "cvar", "mean-variance", "entropic", "crra", "target"] = doc(
        "statistic of the paths that is maximised", "mean"
    )
    level: Annotated[float, Range(0, 1, "()")] | None = doc(
        'confidence level: "cvar" is the mean of the worst 1 - level of the paths', None
    )
    risk_aversion: Positive | None = doc(
        'risk aversion: in 1/currency for "mean-variance" and "entropic", a pure number for "crra"',
        None,
    )
    wealth: Positive | None = doc(
        'wealth that "crra" adds to the total of a path, in currency', None
    )
    target: float | None = doc('total that "target" aims at, in currency', None, "a number")

    @property
    def keeps_unit(self) -> bool:
        """Whether the statistic has the unit of the output."""
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

    Keys in `optional` may be omitted, although other domains require them.
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
    """The `weight` of one of several objectives that are added up; 1 if it is omitted. A negative
    weight turns a risk measure into the risk measure of a cost (see `snapo.problem.objective`); a
    utility needs a positive weight.
    """
    weight = data.get("weight", 1.0)
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not weight:
        raise CaseError(file, f"{name}.weight", weight, "it must be a number other than 0")
    if objective.kind == "crra" and weight < 0:
        message = "a utility must be of a quantity that is maximised: "
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
        message = f"it must be at most temperature_start, which is {training.temperature_start:g}"
        raise CaseError(file, where, value, message)
    if training.exploration and training.temperature_end == training.temperature_start:
        where, value = "training.temperature_end", training.temperature_end
        message = "exploration falls with the temperature, so it must be below temperature_start"
        raise CaseError(file, where, value, message)
    return training


def check_window(training: TrainingTable, kinds: Iterable[str], file: str) -> None:
    """Refuses training on windows for objectives that have no continuation value."""
    for kind in kinds:
        if training.window != "auto" and kind != "mean":
            message = f'windows need an objective of kind "mean", but the kind is "{kind}"'
            raise CaseError(file, "training.window", training.window, message)


def read_evaluation(data: Mapping, file: str) -> EvaluationTable:
    """Reads `[evaluation]`."""
    return parse(EvaluationTable, data, file, "evaluation")
