"""Inputs whose derivative is lost, with the lines that cut it off."""

from jaxtyping import PyTree

from snapo.problem.code.lost import lost
from snapo.problem.problem import in_mean
from snapo.problem.simulator import Simulator

from .findings import Notes
from .program.methods import line_of


def lost_derivatives(notes: Notes, simulator: Simulator, inputs: PyTree) -> None:
    """Inputs that are rounded or compared on their only way to the outputs, as warnings."""
    right = in_mean(simulator, inputs)
    for name, equations in lost(simulator, inputs).items():
        if name in right:
            continue
        lines = dict.fromkeys(line for eqn in equations if (line := line_of(eqn)))
        positions = ", ".join(map(str, lines))
        texts = " In: " + "; ".join(line.text for line in lines) if lines else ""
        notes.warning(
            f"input {name}" + (f" ({positions})" if positions else ""),
            "Its derivative is lost: it is rounded, made a whole number or compared on every way "
            f"to the outputs, so that the derivative is 0 on every path and not known.{texts}",
            "Draw whole numbers with snapo.noise (Poisson, Binomial, Empirical), whose derivative "
            "is right in the mean, use smooth.indicator and smooth.round, or leave it unrounded.",
        )
