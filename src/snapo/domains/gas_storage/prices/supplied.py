"""`[model]` of kind "supplied": price paths of the user, from two different files."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, read_array
from snapo.case.error import CaseError, Unquoted
from snapo.case.table import CaseTable, Nonempty, TableContext, doc
from snapo.problem.record import Schedule, field
from snapo.problem.record.arrays import Array, Float, jnp

from .process import Delivery, PriceProcess, Times, register

if TYPE_CHECKING:
    from snapo.problem.scenarios import Sources


PATHS = "the name of a .npy or .parquet file"


class SuppliedTable(CaseTable):
    """`[model]` of kind "supplied"."""

    kind: Literal["supplied"] = doc("your own price paths")
    training_paths: Nonempty = doc("price paths for training, [path, day]", allowed=PATHS)
    evaluation_paths: Nonempty = doc("other price paths, for evaluation", allowed=PATHS)
    rescale_to_curve: bool = doc(
        "whether the paths are scaled so that their mean is the forward curve", False
    )


@dataclass(frozen=True, eq=False)
class SuppliedPaths:
    """The prices in two files, or their ratios to the forward curve: [paths, T], or [paths, T + 1]
    if the end date needs a price."""

    training: np.ndarray
    evaluation: np.ndarray

    def use(self) -> None:
        """The paths are scenarios, and not part of a simulator."""


class SuppliedStep(NamedTuple):
    """The forward price of the day."""

    forward: Array


@register
class SuppliedPrices(PriceProcess):
    """Prices from a file; its paths replace the noise.

    If `rescaled`, the arrays are factors that multiply the forward curve: the prices of each day,
    divided by their mean over the paths of the file. Otherwise they are prices in currency per
    unit, which do not depend on the forward curve; only `scale`, the mean size of the curve, is
    used.
    """

    kind = "supplied"
    table = SuppliedTable
    martingale = False
    delivery: Times
    scale: Float[np.ndarray, ""]
    paths: SuppliedPaths
    rescaled: bool = field(static=True)
    noise_size: int = field(static=True, default=1)

    @classmethod
    def read(cls, section: TableContext, table: SuppliedTable, delivery: Delivery):
        days, numbers = delivery.price_days, delivery.curve.used()
        size = np.asarray(np.mean(np.abs(numbers)) or 1.0) if len(numbers) else np.ones(())
        if not days:
            # No decision is left: whatever the paths say is over.
            none = SuppliedPaths(np.zeros((2, 0)), np.zeros((2, 0)))
            return cls(delivery.times, size, none, table.rescale_to_curve)  # pyright: ignore
        span = f"one for each day from {days[0]} to {days[-1]}"
        references = [
            FileReference(section, key, getattr(table, key))
            for key in ("training_paths", "evaluation_paths")
        ]
        arrays = [read_array(reference, len(days), span) for reference in references]
        if np.array_equal(arrays[0], arrays[1]):
            message = (
                "this file has the same paths as training_paths; evaluation needs different paths"
            )
            raise references[1].error(message)
        if table.rescale_to_curve:
            arrays = [
                _noise(mention.name, array, days)
                for mention, array in zip(references, arrays, strict=True)
            ]
        paths = SuppliedPaths(*arrays)
        return cls(delivery.times, size, paths, table.rescale_to_curve)  # pyright: ignore

    @property
    def proportional(self) -> bool:
        return self.rescaled

    @property
    def initial_noise_size(self) -> int:
        return 1

    def prepare(self, inputs) -> Schedule:
        scale = jnp.ones(()) if self.rescaled else jnp.asarray(self.scale)
        return Schedule(scale, SuppliedStep(self.delivery.forward(inputs)))

    def initial(self, constants, noise):
        return noise

    def step(self, constants, now, state, noise):
        return noise

    def level(self, constants, now, state):
        return now.forward * state[0] if self.rescaled else state[0]

    def forward(self, constants, now):
        return now.forward

    def observe(self, constants, now, state):
        return state / constants

    def state_at(self, constants, now, spot):
        return jnp.atleast_1d(spot / now.forward if self.rescaled else spot)

    def sources(self, seed: int) -> "Sources":
        """Three quarters of the training paths are for training, the others for validation;
        evaluation has separate paths.

        A path starts from the price of the first day; the prices of the days after it are its
        noise.
        """
        from snapo.problem.scenarios import Sources, Supplied  # JAX: of a run, not of a case

        days = len(self.delivery.years) - 1

        def scenarios(paths: np.ndarray) -> Supplied:
            later = np.zeros((days, len(paths), 1))
            successor = paths[:, 1 : days + 1].T
            later[: len(successor), :, 0] = successor
            return Supplied(later, paths[:, :1], seed)

        training, evaluation = map(scenarios, (self.paths.training, self.paths.evaluation))
        first = max(1, 3 * training.size // 4)
        validation = training.part(min(first, training.size - 1), training.size)
        return Sources(training.part(0, first), validation, evaluation)

    def describe(self) -> str:
        return "Supplied price paths" + (", rescaled to the forward curve" * self.rescaled)


def _noise(name: str, array: np.ndarray, days) -> np.ndarray:
    """The paths divided by their mean on each day, so that the expected spot price is the forward
    price."""
    mean = array.mean(axis=0)
    for column in np.flatnonzero(mean <= 0)[:1]:
        got = Unquoted(f"a mean price of {mean[column]:g}")
        message = "rescale_to_curve needs prices whose mean is above 0 on every day"
        raise CaseError(name, f"day {days[column]}", got, message)
    return array / mean
