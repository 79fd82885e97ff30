"""Deltas by traded product for daily contracts, vega by delivery month for all contracts, and gamma
by pair of products or months for contracts on one commodity."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from snapo.case.error import CaseError
from snapo.study.study import StudyRun

from ...gas_storage.chapters import gamma, products, vega
from ...gas_storage.chapters.gamma import ProductGammas, gamma_by_product
from ...gas_storage.chapters.products import ProductDeltas, deltas_by_product
from ...gas_storage.chapters.vega import Vegas, vega_by_month
from ...gas_storage.explain.chain import delivery_periods
from ...gas_storage.hedges.gamma import price_rises
from ...gas_storage.read.tables import FORWARD
from ..core.simulator import simulator_of
from ..read.case import KINDS, EnergyCase
from ..setup import case_of, price_schedule


def measure(run: StudyRun) -> ProductDeltas:
    """The deltas of a contract."""
    case, problem = case_of(run.setup), run.setup.problem
    simulator = simulator_of(problem)
    rate = simulator.rate.in_numpy({x: y.value for x, y in problem.inputs_by_name.items()})
    discount = np.asarray(simulator.paid(jnp.asarray(rate)))[:: KINDS[case.kind].steps]
    return deltas_by_product(run, case.products, case.market.forward_curve.name, discount)


PRODUCT_DELTAS = replace(products.PRODUCT_DELTAS, measure=measure)


def measure_vega(run: StudyRun) -> Vegas:
    """The vega of a contract."""
    days = case_of(run.setup).days
    return vega_by_month(run, (*days, days[-1]))


VEGA = replace(vega.VEGA, measure=measure_vega)


def check_gamma(case: EnergyCase) -> None:
    """Refuses a contract whose gamma is not available.

    **Raises:** `CaseError` for prices of several commodities.
    """
    curves = sorted({x.name for x in case.numbers() if x.group == FORWARD.group})
    if len(curves) > 1:
        message = f"{case.file.name} has {len(curves)} curves, {', '.join(curves)}"
        raise CaseError("--gamma", "", None, f"this is for contracts on one commodity; {message}")


def measure_gamma(run: StudyRun) -> ProductGammas:
    """The gammas of a contract."""
    case, problem = case_of(run.setup), run.setup.problem
    curve = simulator_of(problem).curve
    values = problem.inputs_by_name[curve.name].value
    rises = price_rises(delivery_periods(case.days, case.products), case.days, curve, values)
    return gamma_by_product(run, case, rises, curve.name, price_schedule(problem))


GAMMA = replace(gamma.GAMMA, measure=measure_gamma)
