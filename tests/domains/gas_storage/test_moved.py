"""Which numbers of a store can be moved without compiling anew."""

from tests.domains.gas_storage.storage_cases import read

from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.problem.form import form_of, formed


def two_factors(first: float, second: float):
    """A store with two price factors of these mean reversions."""
    factors = [
        {"mean_reversion": first, "volatility": 0.6},
        {"mean_reversion": second, "volatility": 0.3},
    ]
    model = {"kind": "multi-factor", "mean_reversion": None, "volatility": None}
    correlation = [[1.0, 0.3], [0.3, 1.0]]
    return read("quick", model=model | {"factors": factors, "correlation": correlation}).model


def test_the_same_form_as_long_as_the_same_factor_is_the_fast_one():
    form = form_of(formed(two_factors(12.0, 3.0)))
    assert form == form_of(formed(two_factors(10.0, 4.0)))
    assert form != form_of(formed(two_factors(2.0, 3.0)))


def test_the_scales_of_the_features_are_those_of_the_moved_case():
    simulator = StorageSimulator.of(read("quick", contract={"max_withdrawal": 12.0}))
    assert simulator.rate_scale == 12.0
