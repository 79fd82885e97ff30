"""Deltas by traded product, of a daily contract."""

from dataclasses import replace

import numpy as np

from snapo.study.study import StudyRun

from ...gas_storage.chapters import products
from ...gas_storage.chapters.products import ProductDeltas, deltas_by_product
from ..setup import case_of


def measure(run: StudyRun) -> ProductDeltas:
    """The deltas of a contract."""
    case, problem = case_of(run.setup), run.setup.problem
    discount = np.abs(problem.schedule.steps.terms.price[:, 0])
    return deltas_by_product(run, case.products, case.market.forward_curve.name, discount)


PRODUCT_DELTAS = replace(products.PRODUCT_DELTAS, measure=measure)
