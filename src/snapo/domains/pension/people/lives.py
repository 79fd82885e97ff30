"""The people whose payments are projected: cohorts of the case, and who enters after them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.case import PensionModel
from ..records.inputs import use
from ..records.people import ACTIVE, DEFERRED, FEMALE, MALE, FundMembers
from .mortality import log_survival, rounded_age

TINY = 1e-9  # of a year


class Lives(NamedTuple):
    """Groups of people of one sex and age. N is the number of steps projected.

    - `sex`, `age` (at time 0, rounded; entrants may be below their entry age), `entry` (step from
      which they count, NumPy), `service` (years at entry): [C].
    - `earning`: [C] bool, whether they work until retirement; `waiting`: [C] bool, whether their
      pension begins at the retirement age only.
    - `base`: [C] pensionable salary of all of them, and `pension`: [C] accrued, money per year.
    - `alive`: [C, N+1] probability to be alive at each time, given that they were at entry.
    - `factor`: [C] on their own death probabilities; None: ones.
    """

    sex: Array
    age: Array
    entry: np.ndarray
    service: Array
    earning: Array
    waiting: Array
    base: Array
    pension: Array
    alive: Array
    factor: Array | None = None


def share_before(until: Any, time: Any, step: float) -> Array:
    """The share of a step that begins at `time` which lies before `until`, years; 0 to 1."""
    share = jnp.clip((until - time) / step, 0.0, 1.0)
    near = TINY / step
    return jnp.where(share < near, 0.0, jnp.where(share > 1 - near, 1.0, share))


def working(case: PensionModel, lives: Lives, steps: int) -> Array:
    """The share of each step that a group is at work: entered, and below the retirement age."""
    time = np.arange(steps)
    age = lives.age[:, None] + time * case.step
    young = share_before(case.plan.retirement_age, age, case.step)
    return young * (lives.earning[:, None] & (time >= lives.entry[:, None]))


def drawing(case: PensionModel, lives: Lives, steps: int) -> Array:
    """The share of each step that a group's own pension is in payment [C, steps]."""
    time = np.arange(steps)
    age = lives.age[:, None] + time * case.step
    old = 1 - share_before(case.plan.retirement_age, age, case.step)
    return jnp.where(lives.waiting[:, None], old, 1.0) * (time >= lives.entry[:, None])


def present(case: PensionModel, inputs: dict[str, Any], members: FundMembers, steps: int) -> Lives:
    """The cohorts of the case."""
    age = rounded_age(case.plan, members.age)
    status = jnp.asarray(members.status)
    earning = status == ACTIVE
    number = use(inputs, members.number)
    salary = jnp.where(earning, use(inputs, members.salary), 0.0)
    factor = None if members.mortality is None else use(inputs, members.mortality)
    above = jnp.maximum(salary - use(inputs, case.plan.offset), 0.0)
    return Lives(
        sex=jnp.asarray(members.sex),
        age=age,
        entry=np.zeros(len(age), int),
        service=jnp.asarray(members.service),
        earning=earning,
        waiting=earning | (status == DEFERRED),
        base=number * jnp.where(earning, above, 0.0),
        pension=number * use(inputs, members.pension),
        alive=jnp.exp(log_survival(case, inputs, members.sex, age, steps, factor)),
        factor=factor,
    )


def entrants(case: PensionModel, inputs: dict[str, Any], lives: Lives, steps: int) -> Lives:
    """Who replaces actives that retire or die: one group per sex and year of entry.

    At the start of each year entrants replace the pensionable salary that was lost since the last
    one, so that it has its level of time 0 at the start of every year.
    """
    item = round(1 / case.step)
    entry = np.arange(item, case.steps, item)
    count = len(entry)
    groups = []
    for sex in (MALE, FEMALE):  # in the order of their numbers
        age = case.plan.entry_age - entry * case.step
        sexes = np.full(count, sex)
        path = log_survival(case, inputs, sexes, age, steps)
        since = np.arange(steps + 1) >= entry[:, None]
        start = path[np.arange(count), entry][:, None]
        groups.append((sexes, age, jnp.exp(jnp.where(since, path - start, 0.0))))
    new = Lives(
        sex=jnp.concatenate([group[0] for group in groups]),
        age=jnp.concatenate([group[1] for group in groups]),
        entry=np.tile(entry, 2),
        service=jnp.zeros(2 * count),
        earning=jnp.ones(2 * count, bool),
        waiting=jnp.ones(2 * count, bool),
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
        needed.append(_renewal(selected[sex * count : (sex + 1) * count], missing))
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
        sex=jnp.concatenate([first.sex, second.sex]),
        age=jnp.concatenate([first.age, second.age]),
        entry=np.concatenate([first.entry, second.entry]),
        service=jnp.concatenate([first.service, second.service]),
        earning=jnp.concatenate([first.earning, second.earning]),
        waiting=jnp.concatenate([first.waiting, second.waiting]),
        base=jnp.concatenate([first.base, second.base]),
        pension=jnp.concatenate([first.pension, second.pension]),
        alive=jnp.concatenate([first.alive, second.alive]),
        factor=factor,
    )
