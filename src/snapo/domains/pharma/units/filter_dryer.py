"""Agitated filter-dryer: one vessel that filters, washes and dries a batch.

Filtration at constant pressure is Ruth's equation, dt/dV = Kp V + B. A wash through the cake runs
at the rate at which filtration ended; a reslurry wash mixes the cake with fresh solvent, which
thins what is dissolved, and filters again. Drying is that of a heated shelf under vacuum, of which
agitation makes the cake one: constant rate, then falling.
"""

from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ..flowsheet.grid import NO_CRYSTALS
from ..flowsheet.ledger import LedgerFinish
from ..given import use
from ..read.fields import number, profile, quantity, word
from ..read.numbers import ValueRange
from .filter import Filter, filtration
from .operation import Inlet
from .tray_dryer import TrayDryer, drying

WASHES = ValueRange(1.0, 20.0, False, "from 1 to 20")


class FilterDryerTable(CaseTable):
    """`type = "filter-dryer"`"""

    type: Literal["filter-dryer"]
    area: Any = quantity('"0.5 m^2"', meaning="filter area")
    filter_pressure: Any = quantity('"2 bar"', meaning="pressure difference of filtration")
    viscosity: Any = quantity('"0.46 mPa*s"', meaning="viscosity of the liquor")
    medium_resistance: Any = quantity('"1e10 1/m"', meaning="resistance of the filter medium")
    porosity: Any = number("a share between 0 and 1", meaning="porosity of the cake")
    saturation: Any = number(
        "a share between 0 and 1", meaning="share of the cake's voids that keeps liquor"
    )
    resistance: Any = quantity('"1e11 m/kg"', None, meaning="specific resistance of the cake")
    wash: Literal["reslurry", "dispersion", "exponential"] = word(
        "reslurry", "dispersion", "exponential", default="reslurry"
    )
    wash_ratio: Any = number(
        "a number, 0 or more", meaning="wash liquid per void volume, of a wash"
    )
    washes: Any = number("a number from 1 to 20", 1.0, meaning="number of reslurry washes")
    efficiency: Any = number("a number above 0", None, meaning="efficiency of the wash")
    peclet: Any = number("a number above 0", None, meaning="Peclet number of the wash")
    duration: Any = quantity('"8 h"', meaning="drying time")
    temperature: Any = profile(meaning="temperature of the jacket")
    pressure: Any = profile(meaning="pressure above the cake while it dries")
    heating_area: Any = quantity('"1.2 m^2"', meaning="heated area that the cake touches")
    heat_transfer: Any = quantity('"60 W/m^2/K"', meaning="heat transfer to the stirred cake")
    mass_transfer: Any = quantity(
        '"7e-10 kg/m^2/s/Pa"', meaning="mass transfer from the crystals' surface"
    )
    critical: Any = quantity('"0.03 kg/kg"', meaning="moisture below which the rate falls")
    heat_capacity: Any = quantity('"1200 J/kg/K"', meaning="heat capacity of the crystals")
    liquid: dict = Field(description="the table liquid")


@dataclass(frozen=True, eq=False)
class Nutsche(Filter):
    """The filter of a filter-dryer; reslurry washes leave (s / (s + W))^n of a solute, s being the
    share of the voids that keeps liquor and W the wash liquid per void volume of each of n."""

    washes: CaseInput | None = None

    def remaining(self, inputs):
        if self.efficiency is not None or self.peclet is not None:
            return super().remaining(inputs)
        assert self.washes is not None
        selected = use(inputs, self.saturation)
        share = selected / (selected + use(inputs, self.wash_ratio))
        return share ** use(inputs, self.washes)

    def deliver(self, network, inlets, inputs):
        """All of the washes' liquid, as often as there are washes."""
        deliver = super().deliver(network, inlets, inputs)
        if self.washes is None:
            return deliver
        cake, filtrate, washings = deliver.outlets
        times, once = use(inputs, self.washes), deliver.ledger.solvent_added
        volume = washings.volume * times
        washings = washings.replace(solvent=washings.solvent + once * (times - 1), volume=volume)
        book = deliver.ledger._replace(solvent_added=once * times)
        return LedgerFinish((cake, filtrate, washings), deliver.measures, book)


@dataclass(frozen=True, eq=False)
class FilterDryer(TrayDryer):
    """Filters and washes by its `nutsche`, and dries as a tray does, over `duration`."""

    nutsche: Nutsche

    type = "filter-dryer"
    variant = ""
    title = "agitated filter-dryer"
    table = FilterDryerTable
    reacts = False
    symbols = (
        *Filter.symbols,
        *(symbol for symbol in TrayDryer.symbols if symbol[0] not in "Aρₛd₃₂"),
    )
    assumptions = ("The stirred cake is ideally mixed, and crystals neither grow nor break.",)

    @classmethod
    def read(cls, read, species):
        table = read.table
        cake = filtration(read, "filter_pressure")
        if table.wash != "reslurry" and "washes" in table.model_fields_set:
            message = f'wash "{table.wash}" has no such key; it belongs to "reslurry"'
            raise read.section.error("washes", table.washes, message)
        nutsche = Nutsche(
            name=read.name,
            wash="dispersion" if table.wash == "dispersion" else "exponential",
            washes=read.number("washes", "1", WASHES) if table.wash == "reslurry" else None,
            **cake,
        )
        return cls(name=read.name, nutsche=nutsche, **drying(read, "heating_area"))

    @property
    def inlets(self):
        return (Inlet("slurry", "needed"),)

    @property
    def outlets(self):
        return ("product", "vapour", "filtrate", "washings")

    def sizes(self, inlets):
        return (inlets[0], NO_CRYSTALS, NO_CRYSTALS, NO_CRYSTALS)

    def measures(self, species):
        measures = self.nutsche.measures(species) | super().measures(species)
        return measures | {"wash_time": "s", "cycle": "s"}

    def equations(self):
        wash = self.nutsche.equations()
        if self.nutsche.washes is not None:
            wash[-1] = "of a solute (s/(s + W))ⁿ stays after n reslurry washes of W void volumes"
        return [*wash, "a wash runs at the last rate of filtration", *super().equations()]

    def dynamics(self, network, inlets, inputs):
        """That of drying, of the cake that filtration and washing leave."""
        filtered = self.nutsche.deliver(network, inlets, inputs)
        cake, filtrate, washings = filtered.outlets
        problem = super().dynamics(network, (cake,), inputs)
        measures = filtered.measures
        wash_time = washings.volume * self.slowness(inlets[0], filtrate, measures, inputs)
        cycle = measures["time"] + wash_time + problem.duration

        def finish(y, *controls):
            dried = problem.finish(y, *controls)
            result = measures | dried.measures | {"wash_time": wash_time, "cycle": cycle}
            added = filtered.ledger.solvent_added
            book = dried.ledger._replace(solvent_added=added)
            return LedgerFinish((*dried.outlets, filtrate, washings), result, book)

        return problem._replace(finish=finish)

    def slowness(self, slurry, filtrate, measures, inputs):
        """s/m3 at the end of filtration: mu (alpha m / A + R_m) / (A dP)."""
        area = use(inputs, self.nutsche.area)
        cake = measures["resistance"] * slurry.crystals() / area
        total = cake + use(inputs, self.nutsche.medium_resistance)
        return (
            use(inputs, self.nutsche.viscosity) * total / area / use(inputs, self.nutsche.pressure)
        )
