"""The people whose payments are projected: the cohorts of the case, and those who enter later."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import solve_lower, xp

from ..records.case import PensionModel
from ..records.inputs import use
from ..records.people import ACTIVE, DEFERRED, FEMALE, MALE, FundMembers
from .mortality import log_survival, rounded_age

TINY = 1e-9  # of a year


class Lives(NamedTuple):
    """Groups of people of the same sex and age. N is the number of projected steps.

    - `sex`, `age` (at time 0, rounded; entrants may be below their entry age), `entry` (step from
      which they count, NumPy), `service` (years at entry): [C].
    - `earning`: [C] bool, whether they work until retirement; `waiting`: [C] bool, whether their
      pension does not begin before the retirement age.
    - `base`: [C] pensionable salary of all of them, and `pension`: [C] accrued, money per year.
    - `alive`: [C, N+1] probability of being alive at each time, if alive at entry.
    - `factor`: [C] factors on their own death probabilities; None means ones.
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
    """For a step that begins at `time`: the share of the step before `until`, from 0 to 1; all
    times are in years."""
    share = xp.clip((until - time) / step, 0.0, 1.0)
    near = TINY / step
    return xp.where(share < near, 0.0, xp.where(share > 1 - near, 1.0, share))


def working(case: PensionModel, lives: Lives, steps: int) -> Array:
    """The share of each step in which a group works: after entry, below the retirement age."""
    time = np.arange(steps)
    age = lives.age[:, None] + time * case.step
    young = share_before(case.plan.retirement_age, age, case.step)
    return young * (lives.earning[:, None] & (time >= lives.entry[:, None]))


def drawing(case: PensionModel, lives: Lives, steps: int) -> Array:
    """The share of each step in which the pension of a group is in payment [C, steps]."""
    time = np.arange(steps)
    age = lives.age[:, None] + time * case.step
    old = 1 - share_before(case.plan.retirement_age, age, case.step)
    return xp.where(lives.waiting[:, None], old, 1.0) * (time >= lives.entry[:, None])


def present(case: PensionModel, inputs: dict[str, Any], members: FundMembers, steps: int) -> Lives:
    """The cohorts of the case."""
    age = rounded_age(case.plan, members.age)
    status = xp.asarray(members.status)
    earning = status == ACTIVE
    number = use(inputs, members.number)
    salary = xp.where(earning, use(inputs, members.salary), 0.0)
    factor = None if members.mortality is None else use(inputs, members.mortality)
    above = xp.maximum(salary - use(inputs, case.plan.offset), 0.0)
    return Lives(
        sex=xp.asarray(members.sex),
        age=age,
        entry=np.zeros(len(age), int),
        service=xp.asarray(members.service),
        earning=earning,
        waiting=earning | (status == DEFERRED),
        base=number * xp.where(earning, above, 0.0),
        pension=number * use(inputs, members.pension),
        alive=xp.exp(log_survival(case, inputs, members.sex, age, steps, factor)),
        factor=factor,
    )


def entrants(case: PensionModel, inputs: dict[str, Any], lives: Lives, steps: int) -> Lives:
    """The lives that replace actives who retire or die: one group per sex and year of entry.

    At the start of each year entrants replace the pensionable salary that was lost in the year
    before, so that at the start of every year this salary has the level of time 0.
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
        groups.append((sexes, age, xp.exp(xp.where(since, path - start, 0.0))))
    new = Lives(
        sex=xp.concatenate([group[0] for group in groups]),
        age=xp.concatenate([group[1] for group in groups]),
        entry=np.tile(entry, 2),
        service=xp.zeros(2 * count),
        earning=xp.ones(2 * count, bool),
        waiting=xp.ones(2 * count, bool),
        base=xp.zeros(2 * count),
        pension=xp.zeros(2 * count),
        alive=xp.concatenate([group[2] for group in groups]),
    )
    in_force = lives.alive[:, entry] * working(case, lives, steps)[:, entry]
    selected = new.alive[:, entry] * working(case, new, steps)[:, entry]
    needed = []
    for sex in (MALE, FEMALE):
        base = xp.where(lives.sex == sex, lives.base, 0.0)
        missing = base.sum() - base @ in_force
        needed.append(_renewal(selected[sex * count : (sex + 1) * count], missing))
    return new._replace(base=xp.concatenate(needed))


def _renewal(selected: Float[Array, "E E"], missing: Float[Array, " E"]) -> Array:
    """Entrants that fill the gap: sum over e' of kept[e', e] entered[e'] = missing[e]."""
    return solve_lower(selected.T, missing)


def joined(first: Lives, second: Lives) -> Lives:
    """Both groups together; only those of the first have factors on their death probabilities."""
    factor = first.factor
    if factor is not None:
        factor = xp.concatenate([factor, xp.ones(len(second.age))])
    return first._replace(
        sex=xp.concatenate([first.sex, second.sex]),
        age=xp.concatenate([first.age, second.age]),
        entry=np.concatenate([first.entry, second.entry]),
        service=xp.concatenate([first.service, second.service]),
        earning=xp.concatenate([first.earning, second.earning]),
        waiting=xp.concatenate([first.waiting, second.waiting]),
        base=xp.concatenate([first.base, second.base]),
        pension=xp.concatenate([first.pension, second.pension]),
        alive=xp.concatenate([first.alive, second.alive]),
        factor=factor,
    )
