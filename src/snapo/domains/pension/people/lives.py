"""The people whose payments are projected: cohorts of the case, and who enters after them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.case import PensionCase
from ..records.inputs import use
from ..records.people import ACTIVE, DEFERRED, FEMALE, MALE, FundMembers
from .mortality import log_survival, rounded_age

TINY = 1e-9  # of a year


class Lives(NamedTuple):
    """Groups of people of one sex and age. N is the number of steps projected.

    - `sex`, `age` (at time 0, rounded; entrants may be below their entry age), `entry` (step from
      which they count), `service` (years at entry): [C], NumPy.
    - `earning`: [C] bool, whether they work until retirement; `waiting`: [C] bool, whether their
      pension begins at the retirement age only.
    - `base`: [C] pensionable salary of all of them, and `pension`: [C] accrued, money per year.
    - `alive`: [C, N+1] probability to be alive at each time, given that they were at entry.
    - `factor`: [C] on their own death probabilities; None: ones.
    """

    sex: np.ndarray
    age: np.ndarray
    entry: np.ndarray
    service: np.ndarray
    earning: np.ndarray
    waiting: np.ndarray
    base: Array
    pension: Array
    alive: Array
    factor: Array | None = None


def share_before(until: float, time: np.ndarray, step: float) -> np.ndarray:
    """The share of a step that begins at `time` which lies before `until`, years; 0 to 1."""
    share = np.clip((until - time) / step, 0.0, 1.0)
    near = TINY / step
    return np.where(share < near, 0.0, np.where(share > 1 - near, 1.0, share))


def working(case: PensionCase, lives: Lives, steps: int) -> np.ndarray:
    """The share of each step that a group is at work: entered, and below the retirement age."""
    time = np.arange(steps)
    age = lives.age[:, None] + time * case.step
    young = share_before(case.plan.retirement_age, age, case.step)
    return young * (lives.earning[:, None] & (time >= lives.entry[:, None]))


def drawing(case: PensionCase, lives: Lives, steps: int) -> np.ndarray:
    """The share of each step that a group's pension is in payment [C, steps]."""
    time = np.arange(steps)
    age = lives.age[:, None] + time * case.step
    old = 1 - share_before(case.plan.retirement_age, age, case.step)
    return np.where(lives.waiting[:, None], old, 1.0) * (time >= lives.entry[:, None])


def present(case: PensionCase, inputs: dict[str, Any], members: FundMembers, steps: int) -> Lives:
    """The cohorts of the case."""
    age = rounded_age(case.plan, members.age)
    earning = members.status == ACTIVE
    number = use(inputs, members.number)
    salary = jnp.where(earning, use(inputs, members.salary), 0.0)
    factor = None if members.mortality is None else use(inputs, members.mortality)
    above = jnp.maximum(salary - use(inputs, case.plan.offset), 0.0)
    return Lives(
        sex=members.sex,
        age=age,
        entry=np.zeros(len(age), int),
        service=members.service,
        earning=earning,
        waiting=earning | (members.status == DEFERRED),
        base=number * jnp.where(earning, above, 0.0),
        pension=number * use(inputs, members.pension),
        alive=jnp.exp(log_survival(case, inputs, members.sex, age, steps, factor)),
        factor=factor,
    )


def entrants(case: PensionCase, inputs: dict[str, Any], lives: Lives, steps: int) -> Lives:
    """Who replaces actives that retire or die: one group per sex and year of entry.

    At the start of each year entrants replace the pensionable salary that was lost since the last
    one, so that it has its level of time 0 at the start of every year.
    """
    item = round(1 / case.step)
    entry = np.arange(item, case.steps, item)
    count = len(entry)
    groups = []
    for sex in (MALE, FEMALE):
        age = case.plan.entry_age - entry * case.step
        sexes = np.full(count, sex)
        path = log_survival(case, inputs, sexes, age, steps)
        since = np.arange(steps + 1) >= entry[:, None]
        start = path[np.arange(count), entry][:, None]
        groups.append((sexes, age, jnp.exp(jnp.where(since, path - start, 0.0))))
    new = Lives(
        sex=np.concatenate([group[0] for group in groups]),
        age=np.concatenate([group[1] for group in groups]),
        entry=np.tile(entry, 2),
        service=np.zeros(2 * count),
        earning=np.ones(2 * count, bool),
        waiting=np.ones(2 * count, bool),
        base=jnp.zeros(2 * count),
        pension=jnp.zeros(2 * count),
        alive=jnp.concatenate([group[2] for group in groups]),
    )
    in_force = lives.alive[:, entry] * working(case, lives, steps)[:, entry]
    selected = new.alive[:, entry] * working(case, new, steps)[:, entry]
    needed = []
    for sex in (MALE, FEMALE):
        base = jnp.where(lives.sex == sex, lives.base, 0.0)
        missing = base.sum() - base @ in_force
        rows = np.flatnonzero(new.sex == sex)
        needed.append(_renewal(selected[rows], missing))
    return new._replace(base=jnp.concatenate(needed))


def _renewal(selected: Float[Array, "E E"], missing: Float[Array, " E"]) -> Array:
    """Entrants that fill the gap: sum over e' of kept[e', e] entered[e'] = missing[e]."""
    return jax.scipy.linalg.solve_triangular(selected.T, missing, lower=True)


def joined(first: Lives, second: Lives) -> Lives:
    """Both together; only the first have separate factors."""
    factor = first.factor
    if factor is not None:
        factor = jnp.concatenate([factor, jnp.ones(len(second.age))])
    return first._replace(
        sex=np.concatenate([first.sex, second.sex]),
        age=np.concatenate([first.age, second.age]),
        entry=np.concatenate([first.entry, second.entry]),
        service=np.concatenate([first.service, second.service]),
        earning=np.concatenate([first.earning, second.earning]),
        waiting=np.concatenate([first.waiting, second.waiting]),
        base=jnp.concatenate([first.base, second.base]),
        pension=jnp.concatenate([first.pension, second.pension]),
        alive=jnp.concatenate([first.alive, second.alive]),
        factor=factor,
    )
