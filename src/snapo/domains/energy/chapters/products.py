"""Deltas by traded product, of a daily contract, and vega by delivery month, of any contract."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from snapo.study.study import StudyRun

from ...gas_storage.chapters import products, vega
from ...gas_storage.chapters.products import ProductDeltas, deltas_by_product
from ...gas_storage.chapters.vega import Vegas, vega_by_month
from ..core.simulator import simulator_of
from ..read.case import KINDS
from ..setup import case_of


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
