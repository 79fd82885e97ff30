"""A simulator without its control variates, where nobody asks for them: less to compile and run."""

import equinox as eqx

from snapo.problem.simulator import Around, Simulator


class Uncontrolled(Around):
    """Without the outputs `left_out`, which are there as control variates alone."""

    left_out: tuple[str, ...] = eqx.field(static=True)

    def step(self, constants, now, state, action, noise, smooth):
        after, outputs = super().step(constants, now, state, action, noise, smooth)
        return after, self._kept(outputs)

    def terminal(self, constants, state, smooth):
        return self._kept(super().terminal(constants, state, smooth))

    def control_variates(self):
        return ()

    def _kept(self, outputs):
        return {name: value for name, value in outputs.items() if name not in self.left_out}


def uncontrolled(simulator: Simulator, outputs: tuple[str, ...]) -> Simulator:
    """The simulator without its control variates, but for these outputs; itself without any."""
    left_out = tuple(name for name in simulator.control_variates() if name not in outputs)
    return Uncontrolled(simulator, left_out) if left_out else simulator  # pyright: ignore
