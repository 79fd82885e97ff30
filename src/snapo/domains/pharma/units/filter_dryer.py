"""Agitated filter-dryer: one vessel that filters, washes and dries a batch.

Filtration at constant pressure is Ruth's equation, dt/dV = Kp V + B. A wash through the cake runs
at the rate at which filtration ended; a reslurry wash mixes the cake with fresh solvent, which
dilutes the dissolved species, and filters again. Drying is as on a heated shelf under vacuum, first
at a constant rate, then at a falling one; agitation keeps the cake uniform.
"""

from dataclasses import dataclass
from typing import Literal

from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import doc

from ..flowsheet.stream import NO_CRYSTALS, LedgerFinish
from ..given import use
from ..read.declared import ABSOLUTE, AREA, PRESSURE, TIME, UnitQuantity, key, keys_of, values
from ..read.numbers import NOT_NEGATIVE, POSITIVE
from ..time.profile import Profile
from .filter import Filter, check_wash
from .operation import Inlet
from .tray_dryer import HEAT_TRANSFER, TrayDryer


@dataclass(frozen=True, eq=False)
class Nutsche(Filter):
    """The filter of a filter-dryer; reslurry washes leave (s / (s + W))^n of a solute, where s is
    the share of the voids in which liquor stays, W the wash liquid per void volume of one wash,
    and n the number of washes."""

    pressure: CaseInput = PRESSURE(
        "pressure difference of filtration", alias="filter_pressure", range=POSITIVE
    )
    wash: Literal["exponential", "dispersion"] = key(
        doc("model of the wash", "reslurry"),
        type=Literal["reslurry", "dispersion", "exponential"],
    )
    wash_ratio: CaseInput = UnitQuantity(range=NOT_NEGATIVE)(
        "wash liquid per void volume, for one wash"
    )
    washes: CaseInput | None = UnitQuantity(range=Range(1.0, 20.0))(
        "number of reslurry washes", 1.0
    )

    def remaining(self, inputs):
        if self.efficiency is not None or self.peclet is not None:
            return super().remaining(inputs)
        assert self.washes is not None
        selected = use(inputs, self.saturation)
        share = selected / (selected + use(inputs, self.wash_ratio))
        return share ** use(inputs, self.washes)

    def deliver(self, network, inlets, inputs):
        """The liquid of all washes together."""
        deliver = super().deliver(network, inlets, inputs)
        if self.washes is None:
            return deliver
        cake, filtrate, washings = deliver.outlets
        times, once = use(inputs, self.washes), deliver.ledger.solvent_added
        volume = washings.volume * times
        washings = washings.replace(solvent=washings.solvent + once * (times - 1), volume=volume)
        book = deliver.ledger._replace(solvent_added=once * times)
        return LedgerFinish((cake, filtrate, washings), deliver.measures, book)


@dataclass(frozen=True, eq=False, kw_only=True)
class FilterDryer(TrayDryer):
    """Filters and washes by its `nutsche`, and dries as a tray does, over `duration`."""

    duration: CaseInput = TIME("drying time", example="8 h")
    temperature: Profile = ABSOLUTE.profile("temperature of the jacket")
    pressure: Profile = PRESSURE.profile("pressure above the cake while it dries")
    area: CaseInput = AREA(
        "heated area that the cake touches", alias="heating_area", example="1.2 m^2"
    )
    heat_transfer: CaseInput = HEAT_TRANSFER("heat transfer to the stirred cake")
    nutsche: Nutsche

    type = "filter-dryer"
    more_keys = keys_of(Nutsche)
    variant = ""
    title = "agitated filter-dryer"
    reacts = False
    symbols = (
        *Filter.symbols,
        *(symbol for symbol in TrayDryer.symbols if symbol[0] not in "Aρₛd₃₂"),
    )
    assumptions = ("The stirred cake is ideally mixed, and crystals neither grow nor break.",)

    @classmethod
    def read(cls, read, species):
        table = read.table
        check_wash(read)
        numbers = values(Nutsche, read)
        if table.wash != "reslurry":
            if "washes" in table.model_fields_set:
                message = f'wash "{table.wash}" has no such key; it belongs to "reslurry"'
                raise read.section.error("washes", read.raw["washes"], message)
            numbers["washes"] = None
        else:
            numbers["wash"] = "exponential"
        nutsche = Nutsche(name=read.name, **numbers)
        return cls(name=read.name, nutsche=nutsche, **values(cls, read))

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
            wash[-1] = "share (s/(s + W))ⁿ of a solute stays after n washes of W void volumes"
        return [
            *wash,
            "wash liquid flows at the rate of the filtrate at the end of filtration",
            *super().equations(),
        ]

    def dynamics(self, network, inlets, inputs):
        """The dynamics of drying the cake that filtration and washing leave."""
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
