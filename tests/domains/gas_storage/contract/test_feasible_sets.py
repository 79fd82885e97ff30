"""A contract that can be met from several intervals of inventories, which policies cannot use."""

import datetime

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, changed

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.domains.gas_storage.contract.feasibility import feasible_sets
from snapo.domains.gas_storage.contract.terms import inventory_limits

FIRST = datetime.date(2025, 1, 1)


@pytest.fixture
def store(tmp_path):
    """The small store for ten days, with these rows of ratchets."""
    for name in ("curve.csv", "case.toml"):
        (tmp_path / name).write_text((CASES / "quick" / name).read_text())

    def read(rows, kind="step", **contract):
        lines = [f"{'' if n else FIRST},{level},{out},{into}"
                 for n, (level, out, into) in enumerate(rows)]  # fmt: skip
        head = "date,inventory,max_withdrawal,max_injection"
        (tmp_path / "ratchets.csv").write_text("\n".join([head, *lines]))
        keys = {
            "end": datetime.date(2025, 1, 11), "max_inventory": 100.0, "inventory": 0.0,
            "ratchets": "ratchets.csv", "ratchet_interpolation": kind,
            "max_injection": None, "max_withdrawal": None,
        }  # fmt: skip
        return changed(tmp_path, contract=keys | contract)

    return read


JUMP = [(0, 20, 20), (30, 60, 20)]


def test_a_set_with_a_hole_is_refused(store):
    """On the last day 20 can be withdrawn from 20, and 60 from 60, but not 25 from 25."""
    message = (
        r"case\.toml, contract\.ratchets: on 2025-01-10 the contract can be met with 0 to 20 or "
        r'30 to 60 in store, but .*"linear"'
    )
    with pytest.raises(CaseError, match=message):
        store(JUMP)


@pytest.mark.parametrize(
    ("rows", "kind", "contract"),
    [
        ([*JUMP, (100, 60, 20)], "linear", {}),
        (JUMP, "step", {"end_inventory": "free"}),
        (JUMP, "step", {"max_inventory": 29.0}),
        ([(0, 20, 20), (20, 60, 20)], "step", {}),  # the intervals touch
        # The second interval, 55 to 60, cannot be reached from an empty store.
        ([(0, 20, 5), (55, 60, 5)], "step", {}),
    ],
)
def test_other_sets_are_whole(store, rows, kind, contract):
    assert store(rows, kind, **contract).days


def test_a_narrow_interval_is_noted(store):
    """From 20 to 20.5 all can be withdrawn on the last day; 40 to 41 lead to these on the day
    before, and other inventories up to 40 to at most 19.5."""
    case = store([(0, 19.5, 20), (20, 20.5, 20)])
    (note,) = [note for note in case.notes if "ratchets" in note]
    assert "on 2025-01-09 the contract can be met with 40 to 41 in store" in note
    with pytest.raises(CaseError, match=r"on 2025-01-10 .* with 0 to 19.5 or 20 to 20.5 in store"):
        store([(0, 19.5, 20), (20, 20.5, 20)], start=datetime.date(2025, 1, 10), inventory=20.0)
    assert not any("ratchets" in note for note in store(JUMP, "step", end_inventory="free").notes)


@pytest.mark.parametrize("inventory", [0.0, 60.0])
def test_a_forced_flow_in_two_places(store, tmp_path, inventory):
    """An injection of 4 is possible near an empty and near a full store only; an empty store cannot
    be filled that far."""
    (tmp_path / "forced.csv").write_text("date,value\n2025-01-01,0\n2025-01-10,4\n")
    rows = [(0, 20, 10), (50, 20, 0), (100, 20, 10)]
    keys = {"inventory": inventory, "min_injection": "forced.csv", "end_inventory": "free"}
    if inventory == 0:
        assert store(rows, "linear", **keys).days
        return
    with pytest.raises(CaseError, match=r"on 2025-01-10 .* with 0 to 30 or 70 to 96 in store"):
        store(rows, "linear", **keys)


def feasible(limits, end, levels):
    """[T + 1, n] whether the contract can be met from these inventories, by moves between them."""
    possible = (levels > end[0]) & (levels < end[1])
    rows = [possible]
    for t in reversed(range(len(limits.minimum))):
        row = np.searchsorted(limits.levels[t], levels, side="right") - 1
        low, high = levels - limits.withdrawal_rate[t, row], levels + limits.injection_rate[t, row]
        reached = (levels >= low[:, None]) & (levels <= high[:, None])
        possible = (reached & possible).any(axis=1)
        rows.append(possible)
    return np.array(rows[::-1])


def test_sets_against_a_grid(store):
    """Random step ratchets. Rates and end are multiples of 4 and rows lie between multiples of 4, so
    that no set is a single inventory, and moves between odd inventories decide."""
    random, split = np.random.default_rng(3), 0
    limits = inventory_limits(store(JUMP, end_inventory="free").contract, CaseInput.used)
    levels = np.arange(1.0, 200.0, 2.0)
    for _ in range(40):
        rows = np.append(0.0, 4.0 * np.sort(random.choice(49, 3, replace=False)) + 2)
        out, into = 4.0 * random.integers(0, 20, (2, 4))
        every = limits._replace(
            levels=np.tile(rows, (10, 1)), withdrawal_rate=np.tile(out, (10, 1)),
            injection_rate=np.tile(into, (10, 1)), maximum=np.full(10, 200.0),
        )  # fmt: skip
        low = 4.0 * random.integers(0, 25)
        sets = feasible_sets(every, low, low + 4, "step")
        exact = feasible(every, (low, low + 4), levels)
        for ranges, possible in zip(sets, exact, strict=True):
            inside = np.zeros(len(levels), bool)
            for first, last in ranges:
                inside |= (levels > first) & (levels < last)
            assert np.array_equal(inside, possible)
            split += len(ranges) > 1
    assert split > 20
