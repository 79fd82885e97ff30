"""A jacket around a reactor, and the heat balance that it brings."""

from dataclasses import dataclass

from snapo.case.given import CaseInput

from ...read.declared import ABSOLUTE, TableRecord, UnitQuantity
from ...read.numbers import NOT_NEGATIVE, POSITIVE
from ...time.profile import Profile


@dataclass(frozen=True, eq=False)
class Jacket(TableRecord):
    """Heat balance: rho cp V dT/dt = -sum(H_i r_i) V - UA (T - T_jacket) + inflow's sensible heat.

    `conductance`: UA; for a plug-flow reactor of its whole length.
    """

    heat_capacity: CaseInput = UnitQuantity("J/m3/K", POSITIVE, example="1.9e6 J/m^3/K")(
        "heat capacity of the mixture"
    )
    conductance: CaseInput = UnitQuantity("W/K", NOT_NEGATIVE, example="120 W/K")(
        "heat conductance to the jacket"
    )
    temperature: Profile = ABSOLUTE.profile("temperature of the jacket")

    heading = "`[units.NAME.jacket]`"
