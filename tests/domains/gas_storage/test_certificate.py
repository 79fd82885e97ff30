"""The certificate of right contracts that stand on many kinks at once: no false alarm."""

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, changed

from snapo.domains.gas_storage.chapters.certificate import off_ties
from snapo.domains.gas_storage.setup import make_setup
from snapo.solver import certificate
from snapo.solver.certificate import certify_derivatives

# A swing contract is a full store that is never filled: all limits tie on every path.
SWING = {
    "inventory": 500.0, "max_inventory": 500.0, "max_injection": 0.0, "max_withdrawal": 20.0,
    "end_inventory": 0.0, "injection_cost": 0.0, "withdrawal_cost": 20.0,
}  # fmt: skip
CONTRACTS = {"take or pay": SWING, "loss": {"inventory_loss": 0.002}, "round numbers": {}}


def certified(contract):
    setup = make_setup(changed(CASES / "quick", contract=contract), "native")
    engine = setup.engines.evaluate
    policy = setup.policy.value_rule  # pyright: ignore[reportAttributeAccessIssue]
    return certify_derivatives(setup.problem, policy, paths=128, near=off_ties, engine=engine)


@pytest.mark.prove
@pytest.mark.parametrize("name", CONTRACTS)
def test_right_derivatives_pass(name):
    found = certified(CONTRACTS[name])
    assert [bump for bump in found if not bump.passed] == []
    # What is not judged at kinks of all paths is judged nearby.
    nearby = {bump.input for bump in found if "nearby" in bump.direction and bump.crossing < 1}
    assert {bump.input for bump in found if not bump.judged} <= nearby


@pytest.mark.prove
@pytest.mark.parametrize("of", ["inventory", "forward_curve", "max_withdrawal", "end_inventory"])
def test_a_derivative_that_is_wrong_by_a_thousandth_is_found(monkeypatch, of):
    right = certificate._Replay.gradient

    def wrong(*given):
        gradient = right(*given)
        return gradient | {of: gradient[of] * 1.001}

    monkeypatch.setattr(certificate._Replay, "gradient", wrong)
    found = certified(SWING)
    assert {bump.input for bump in found if not bump.passed} == {of}
    assert np.isfinite([bump.adjoint for bump in found]).all()
