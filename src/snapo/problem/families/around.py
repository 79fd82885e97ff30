"""A simulator around another one: all is that of the inner one, save what a subclass changes."""

from ..actions import Actions
from ..simulator import Simulator


class Around(Simulator):
    """Hands everything on to `own`."""

    own: Simulator

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.horizon

    @property
    def action(self) -> Actions:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.action

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.noise_size

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.initial_noise_size

    def prepare(self, inputs):
        return self.own.prepare(inputs)

    def initial(self, constants, noise):
        return self.own.initial(constants, noise)

    def observe(self, constants, now, state):
        return self.own.observe(constants, now, state)

    def step(self, constants, now, state, action, noise, smooth):
        return self.own.step(constants, now, state, action, noise, smooth)

    def terminal(self, constants, state, smooth):
        return self.own.terminal(constants, state, smooth)

    def totals(self):
        return self.own.totals()

    def control_variates(self):
        return self.own.control_variates()

    def state_scale(self, constants):
        return self.own.state_scale(constants)

    def slack(self, constants, now, state, outputs):
        return self.own.slack(constants, now, state, outputs)
