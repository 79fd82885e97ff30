"""One policy for similar contracts: its numbers, its loss, and the way back."""

import json

import jax
import numpy as np
import pytest
from tests.book.books import HERE, write_book

from snapo.book import plan as plans
from snapo.book.collect import position, reader
from snapo.book.file import read_book
from snapo.book.folder import BookFolder
from snapo.book.plan import BookPlan
from snapo.book.run import Driver, plan_of, run_book
from snapo.book.work import compute
from snapo.problem.policy import load_policy, trainable
from snapo.solver import statistics

ROWS = [{"name": f"c{i}", "quantity": 1, "contract.injection_cost": 0.01 * i} for i in range(1, 7)]
TASKS = "[tasks]\npaths = 512\njudge = {judge}\npolicy = '{policy}'\n"


@pytest.fixture(scope="module")
def valued(tmp_path_factory):
    """{policy: the book with its folder and its result}."""
    folder, books = tmp_path_factory.mktemp("shared"), {}
    for policy in ("contract", "shape"):
        more = TASKS.format(judge=0, policy=policy)
        file = write_book(folder / policy, ROWS, more=more)
        out = folder / policy / "run"
        books[policy] = read_book(file), BookFolder(out), run_book(
            read_book(file), lambda _: None, HERE, out=out
        )  # fmt: skip
    return books


def members(book, folder):
    return {x.name: position(plan_of(book), x, folder, {}) for x in book.contracts}


def trained(policy: bytes, folder) -> list[np.ndarray]:
    (folder / "p.npz").write_bytes(policy)
    return jax.tree.leaves(trainable(load_policy(folder / "p.npz"))[0])


@pytest.mark.prove
def test_the_others_take_the_numbers_of_the_first(valued, tmp_path):
    book, folder, result = valued["shape"]
    one = members(book, folder)
    assert result["status"] == "ok"
    # Six contracts, and three of them once more with the first one's policy.
    assert result["orders"]["computed"] == plan_of(book).size == 9
    first, second, *_, last = (trained(x.policy, tmp_path) for x in one.values())
    assert all(map(np.array_equal, first, last))
    assert not all(map(np.array_equal, first, second))
    (shared,) = result["shared_policies"]
    assert (shared["leader"], shared["contracts"], shared["is_shared"]) == ("c1", 6, True)
    assert [x["case"] for x in shared["losses"]] == ["c2", "c3", "c4"]
    assert all(abs(x["share"]) <= plans.MAX_LOSS for x in shared["losses"])
    # All that the others have: derivatives, exposure, stresses.
    for name in ("c5", "c6"):
        assert {x.input for x in one[name].base.deltas} == {x.input for x in one["c1"].base.deltas}
        assert one[name].base.exposure and len(one[name].points) == 3
    page = (folder.path / "report.html").read_text()
    assert "The contracts similar to c1 (6 in all) take its trained policy." in page


@pytest.mark.prove
def test_the_loss_is_that_of_trained_policies_on_common_paths(valued):
    """Of the sixth contract too, which no test of the book has seen."""
    apart, shared = (members(*valued[policy][:2]) for policy in ("contract", "shape"))
    for name in ("c1", "c2", "c3", "c4"):
        np.testing.assert_array_equal(apart[name].base.shares, shared[name].base.shares)
    loss = statistics.of_shares(apart["c6"].base.shares - shared["c6"].base.shares)
    assert abs(loss.value) <= plans.MAX_LOSS * apart["c6"].base.value
    assert shared["c6"].base.value != apart["c6"].base.value


@pytest.mark.prove
def test_a_loss_that_is_too_large_trains_all(tmp_path, valued, monkeypatch):
    monkeypatch.setattr(plans, "MAX_LOSS", -1.0)
    file = write_book(tmp_path, ROWS, more=TASKS.format(judge=0, policy="shape"))
    result = run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "run")
    assert [x["is_shared"] for x in result["shared_policies"]] == [False]
    one = members(read_book(file), BookFolder(tmp_path / "run"))
    for name, alone in members(*valued["contract"][:2]).items():
        np.testing.assert_array_equal(one[name].base.shares, alone.base.shares)
        assert one[name].policy == alone.policy


def test_few_contracts_train_their_own(tmp_path):
    file = write_book(tmp_path, ROWS[:4], more=TASKS.format(judge=0.5, policy="shape"))
    plan = plan_of(read_book(file))
    assert plan.size == 4 and not plan.tested and not plan.adopting


def test_judged_contracts_come_first(tmp_path):
    """A judged contract trains its own policy, whose derivatives are tested."""
    more = TASKS.format(judge=0.9, policy="shape")
    plan = BookPlan(read_book(write_book(tmp_path, ROWS, more=more)))
    assert plan.judged == {"c1", "c2", "c3", "c4", "c5", "c6"} and not plan.adopting
    more = TASKS.format(judge=0.1, policy="shape")
    plan = BookPlan(read_book(write_book(tmp_path / "few", ROWS, more=more)))
    assert plan.judged == {"c1", "c2", "c3"} and plan.adopting == {"c5", "c6"}
    assert plan.awaited == {"c1", "c2", "c3", "c4"}
    (last,) = [x for x in plan.book.contracts if x.name == "c6"]
    assert plan.base(last, reader(BookFolder(tmp_path / "none"), {})) is None


@pytest.mark.prove
def test_a_first_contract_without_a_policy_leaves_the_others_their_own(tmp_path):
    rows = [row | {"contract.max_inventory": 1000 * i} for i, row in enumerate(ROWS)]
    file = write_book(tmp_path, rows, stresses="", more=TASKS.format(judge=0, policy="shape"))
    result = run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "run")
    assert result["cases"] == {"ok": 5, "failed": 1}
    assert [x["is_shared"] for x in result["shared_policies"]] == [False]
    assert json.loads((tmp_path / "run" / "result.json").read_text())["shared_policies"]


def test_a_first_contract_without_a_policy_is_no_reason_to_test_it(tmp_path):
    """Of a book that asks for values alone, the job of a test would be one that is in work."""
    rows = [row | {"contract.max_inventory": 1000 * i} for i, row in enumerate(ROWS)]
    tasks = TASKS.format(judge=0, policy="shape") + "deltas = 'none'\nexposure = false\n"
    plan = plan_of(read_book(write_book(tmp_path, rows, stresses="", more=tasks)))
    folder = BookFolder(tmp_path / "run")
    folder.prepare({}, keep=False)
    driver = Driver(plan, plan.book.contracts, folder)
    leader, *others = (driver.next_job() for _ in range(4))
    assert leader is not None and driver.next_job() is None
    driver.take(leader, compute(leader))
    assert driver.next_job() not in others and driver.next_job() not in others
    assert driver.next_job() is None
