"""A small case with a simulator of one's own: a shop that orders each day."""

from pathlib import Path

SIMULATOR = '''
import jax.numpy as jnp
import snapo


class Shop(snapo.Simulator):
    """Sells at most its stock and buys more; holding stock costs."""

    horizon, noise_size = 8, 1
    action = snapo.Box(0.0, 20.0)

    def prepare(self, inputs):
        return snapo.Schedule(constants=inputs, steps={"demand": inputs["demand"]})

    def initial(self, constants, noise):
        return {"stock": constants["stock"]}

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"] / 10, now["demand"] / 10])

    def step(self, constants, now, state, action, noise, smooth):
        there = state["stock"] + action[0]
        demand = now["demand"] * jnp.exp(0.3 * noise[0])
        sold = smooth.minimum(there, demand, scale=10.0)
        left = there - sold
        profit = constants["price"] * sold - constants["cost"] * action[0] - 0.1 * left
        return {"stock": left}, {"profit": profit, "sold": sold}

    def slack(self, constants, now, state, outputs):
        return {"stock": state["stock"]}
'''

CASE = """
kind = "own"
title = "Shop"
step = "day"
[objective]
output = "profit"
[inputs]
stock = { value = 5, unit = "pieces", words = "at the start", move = 1 }
price = { value = 3, unit = "EUR", move = 0.1, trade_unit = "cents", trade_factor = 100 }
cost = { value = 1, unit = "EUR" }
demand = { file = "demand.csv", column = "mean", label = "day", unit = "pieces" }
[units]
profit = "EUR"
stock = "pieces"
[training]
steps = 30
paths = 64
validation_every = 10
validation_paths = 256
[evaluation]
paths = 1024
sensitivity_paths = 512
"""

DEMAND = "day,mean\n" + "".join(f"d{i},{10 + i}\n" for i in range(8))


def write(folder: Path, simulator: str = SIMULATOR, case: str = CASE) -> Path:
    """The case in a folder, and the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "simulator.py").write_text(simulator)
    (folder / "case.toml").write_text(case)
    (folder / "demand.csv").write_text(DEMAND)
    return folder


PLACE = ["--simulator", "simulator:Shop"]
