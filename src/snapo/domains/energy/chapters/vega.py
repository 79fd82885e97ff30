"""Vega by delivery month, of any contract."""

from dataclasses import replace

from snapo.study.study import StudyRun

from ...gas_storage.chapters import vega
from ...gas_storage.chapters.vega import Vegas, vega_by_month
from ..setup import case_of


def measure(run: StudyRun) -> Vegas:
    """The vega of a contract."""
    case = case_of(run.setup)
    return vega_by_month(run, (*case.days, case.days[-1]))


VEGA = replace(vega.VEGA, measure=measure)
