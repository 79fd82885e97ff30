"""A jacket around a reactor, and the heat balance that it brings."""

from dataclasses import dataclass
from typing import Any

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ...read.fields import profile, quantity
from ...read.numbers import NOT_NEGATIVE, POSITIVE
from ...read.reader import Reader
from ...time.profile import Profile


class JacketTable(CaseTable):
    """`[units.NAME.jacket]`"""

    heat_capacity: Any = quantity('"1.9e6 J/m^3/K"', meaning="heat capacity of the mixture")
    conductance: Any = quantity('"120 W/K"', meaning="heat conductance to the jacket")
    temperature: Any = profile(meaning="temperature of the jacket")


@dataclass(frozen=True, eq=False)
class Jacket:
    """Heat balance: rho cp V dT/dt = -sum(H_i r_i) V - UA (T - T_jacket) + inflow's sensible heat.

    - `heat_capacity`: J/m3/K of the mixture, []; `conductance`: UA in W/K, []; for a plug-flow
      reactor of its whole length. `temperature`: of the jacket, a profile in K.
    """

    heat_capacity: CaseInput
    conductance: CaseInput
    temperature: Profile


def read_jacket(read: Reader) -> Jacket:
    """The heat balance, where a reactor has one."""
    return Jacket(
        heat_capacity=read.number("heat_capacity", "J/m3/K", POSITIVE),
        conductance=read.number("conductance", "W/K", NOT_NEGATIVE),
        temperature=read.profile("temperature", "K"),
    )
