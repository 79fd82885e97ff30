"""The tables that every case has: `[training]`, `[evaluation]` and `[objective]`."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import Field

from .error import CaseError
from .table import CaseTable, Count, Positive, parse

MAX_PATHS = 100_000_000  # more path totals than fit in the memory of one machine
MAX_STEPS = 1_000_000_000  # of training: JAX counts in 32 bits
PATHS = "a whole number, 64 to 100,000,000: more do not fit in memory"
AT_MOST = "a whole number, 0 (none) to 100,000,000, the maximum to be used"


class TrainingTable(CaseTable):
    """`[training]`: how the policy is trained, with the fields of `snapo.Training`."""

    steps: Annotated[int, Field(ge=0, le=MAX_STEPS)] = Field(
        240, description="a whole number, 0 to 1,000,000,000"
    )
    paths: Annotated[int, Field(ge=2, le=MAX_PATHS)] = Field(
        512, description="a whole number, 2 to 100,000,000: more do not fit in memory"
    )
    learning_rate: Positive = Field(0.01, description="a number above 0")
    warmup: Annotated[int, Field(ge=0, le=MAX_STEPS)] = Field(
        20, description="a number of steps, 0 to 1,000,000,000"
    )
    decay: Annotated[float, Field(ge=0, le=1e6)] = Field(0.0, description="a number, 0 or more")
    temperature_start: Positive = Field(0.02, description="a number above 0")
    temperature_end: Positive = Field(0.005, description="a number above 0")
    average: Annotated[float, Field(gt=0, le=1)] = Field(
        0.05, description="a number above 0, at most 1"
    )
    validation_paths: Annotated[int, Field(ge=1, le=MAX_PATHS)] = Field(
        4096, description="a whole number, 1 to 100,000,000: more do not fit in memory"
    )
    validation_every: Count | None = Field(
        None,
        description="a number of steps, 1 or more, or left out: 50, and in a short training a "
        "quarter of its steps",
    )
    patience: Count | None = Field(None, description="a number of validations, 1 or more")
    window: Count | Literal["auto"] = Field(
        "auto", description='a number of steps, 1 or more, or "auto"'
    )
    clip: Positive | Literal["auto"] = Field("auto", description='a number above 0, or "auto"')
    keep: Annotated[float, Field(gt=0, le=1)] | Literal["auto"] = Field(
        "auto", description='a number above 0, at most 1, or "auto"'
    )
    spread: Positive = Field(1.0, description="a number above 0")
    exploration: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.0, description="a number from 0 to below 1"
    )
    starts: Count = Field(1, description="a number of initial weights, 1 or more")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(0, description="a whole number, 0 or more")


AUTO = "or left out: it is then chosen from the problem"


class FollowingTable(TrainingTable):
    """`[training]` of a plant or of a user-defined simulator: six keys are chosen from the problem.

    They do so where they are left out, as in `snapo.Training`.
    """

    steps: Annotated[int, Field(ge=0, le=MAX_STEPS)] | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        None, description=f"a whole number, 0 to 1,000,000,000, {AUTO}"
    )
    paths: Annotated[int, Field(ge=2, le=MAX_PATHS)] | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        None,
        description=f"a whole number, 2 to 100,000,000, as more do not fit in memory, {AUTO}",
    )
    learning_rate: Positive | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        None, description=f"a number above 0, {AUTO}"
    )
    decay: Annotated[float, Field(ge=0, le=1e6)] | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        None, description=f"a number, 0 or more, {AUTO}"
    )
    exploration: Annotated[float, Field(ge=0, lt=1)] | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        None, description=f"a number from 0 to below 1, {AUTO}"
    )
    starts: Count | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        None, description=f"a number of initial weights, 1 or more, {AUTO}"
    )


AnyTraining = TypeVar("AnyTraining", bound=TrainingTable)


class EvaluationTable(CaseTable):
    """`[evaluation]`: the fresh scenarios on which the exact value is measured.

    `judge_paths`: of the bumps that the derivatives are tested by; `search_paths`: of the search
    around the policy, which gives every interval the policy's part; `selection_paths`: of the final
    choice between the trained policies and the starting rule. All three "at most", 0 to do without.
    """

    paths: Annotated[int, Field(ge=64, le=MAX_PATHS)] = Field(65536, description=PATHS)
    sensitivity_paths: Annotated[int, Field(ge=64, le=MAX_PATHS)] = Field(16384, description=PATHS)
    judge_paths: Annotated[int, Field(ge=0, le=MAX_PATHS)] = Field(16384, description=AT_MOST)
    search_paths: Annotated[int, Field(ge=0, le=MAX_PATHS)] = Field(16384, description=AT_MOST)
    selection_paths: Annotated[int, Field(ge=0, le=MAX_PATHS)] = Field(16384, description=AT_MOST)
    scenarios: Literal["pseudo-random", "sobol"] = Field(
        "pseudo-random", description='"pseudo-random" or "sobol"'
    )


class ObjectiveTable(CaseTable):
    """`[objective]`: the figure to maximise; `kind` determines which of the other keys apply.

    `level`: "cvar" is the mean of the worst 1 - level of the paths. `risk_aversion`: of
    "mean-variance" and "entropic" in 1/currency, of "crra" a pure number. `wealth`: currency,
    added to each path's total under "crra". `target`: currency, the aim of "target".
    """

    kind: Literal["mean", "cvar", "mean-variance", "entropic", "crra", "target"] = Field(
        "mean", description='"mean", "cvar", "mean-variance", "entropic", "crra" or "target"'
    )
    level: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="a number between 0 and 1"
    )
    risk_aversion: Positive | None = Field(None, description="a number above 0")
    wealth: Positive | None = Field(None, description="a number above 0")
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
    """`weight` of one of several objectives that are added up, 1 where it is left out.

    A negative one makes of a measure of risk that of a cost (see `snapo.problem.objective`), which
    a utility has not.
    """
    weight = data.get("weight", 1.0)
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not weight:
        raise CaseError(file, f"{name}.weight", weight, "allowed is a number other than 0")
    if objective.kind == "crra" and weight < 0:
        message = "a utility is of a quantity to be maximised: "
        message += 'with kind "crra" allowed is a number above 0'
        raise CaseError(file, f"{name}.weight", weight, message)
    return float(weight)


def read_training(
    data: Mapping, file: str, table: type[AnyTraining] = TrainingTable
) -> AnyTraining:
    """Reads `[training]`; the temperature may only fall."""
    training = parse(table, data, file, "training")
    if training.temperature_end > training.temperature_start:
        where, value = "training.temperature_end", training.temperature_end
        message = f"allowed is at most temperature_start, {training.temperature_start:g}"
        raise CaseError(file, where, value, message)
    if training.exploration and training.temperature_end == training.temperature_start:
        where, value = "training.temperature_end", training.temperature_end
        message = (
            "with exploration, which falls with the temperature, it is below temperature_start"
        )
        raise CaseError(file, where, value, message)
    return training


def check_window(training: TrainingTable, kinds: Iterable[str], file: str) -> None:
    """Refuses training on windows for objectives that have no continuation value."""
    for kind in kinds:
        if training.window != "auto" and kind != "mean":
            message = f'windows need an objective of kind "mean", and there is "{kind}"'
            raise CaseError(file, "training.window", training.window, message)


def read_evaluation(data: Mapping, file: str) -> EvaluationTable:
    """Reads `[evaluation]`."""
    return parse(EvaluationTable, data, file, "evaluation")
