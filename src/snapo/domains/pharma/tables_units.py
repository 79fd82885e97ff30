"""The tables `[units.NAME]` of a pharma case; `type` says which of them it is."""

from typing import Annotated, Any, Literal

from pydantic import Field

from snapo.case.table import Table

from .tables import Text, Texts, profile, quantity, word

NUMBER = "a number, such as 1.32"


class JacketTable(Table):
    """`[units.NAME.jacket]`"""

    heat_capacity: Any = quantity('"1.9e6 J/m^3/K"')
    conductance: Any = quantity('"120 W/K"')
    temperature: Any = profile()


class ReactorTable(Table):
    """`type = "reactor"`"""

    type: Literal["reactor"]
    kind: Literal["batch", "semi-batch", "stirred", "plug-flow"] = word(
        "batch", "semi-batch", "stirred", "plug-flow", default="batch"
    )
    duration: Any = quantity('"3600 s"')
    temperature: Any = profile()
    volume: Any = quantity('"10 L"', None)
    dosing: Any = profile(None)
    jacket: dict | None = Field(None, description="the table jacket")
    cells: Annotated[int, Field(ge=1, le=1000)] = Field(50, description="a whole number, 1 or more")
    filled: Literal["feed", "solvent"] = word("feed", "solvent", default="feed")


class SolubilityTable(Table):
    """`[units.NAME.solubility]`"""

    kind: Literal["polynomial", "exponential"] = word(
        "polynomial", "exponential", default="polynomial"
    )
    coefficients: Annotated[list[float], Field(min_length=1)] = Field(
        description="a list of numbers, of rising powers of the temperature"
    )
    unit: Text = Field("kg/m^3", description='a unit such as "kg/m^3"')
    scale: Literal["K", "degC"] = word("K", "degC", default="K")
    antisolvent: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="two numbers"
    )


class KineticsTable(Table):
    """`[units.NAME.kinetics]`"""

    growth: Any = quantity('"5 um/s"')
    growth_order: Any = Field(description=NUMBER)
    dissolution: Any = quantity('"1 um/s"', "0 m/s")
    dissolution_order: Any = Field(1.0, description=NUMBER)
    primary: Any = quantity('"3e8 1/m^3/s"', "0 1/m^3/s")
    primary_order: Any = Field(1.0, description=NUMBER)
    secondary: Any = quantity('"4.46e10 1/m^3/s"', "0 1/m^3/s")
    secondary_order: Any = Field(1.0, description=NUMBER)
    crystal_order: Any = Field(1.0, description=NUMBER)
    rounding: Any = Field(5e-6, description="a number above 0")


class SeedTable(Table):
    """`[units.NAME.seed]`"""

    loading: Any = quantity('"0.02 kg/m^3"', None)
    size: Any = quantity('"20 um"', None)
    spread: Any = Field(None, description="a number above 0, such as 0.3")
    moments: list[Any] | None = Field(None, description="six quantities, m^k/m^3 for k = 0 to 5")


class SizesTable(Table):
    """`[units.NAME.sizes]`"""

    smallest: Any = quantity('"0 um"')
    largest: Any = quantity('"400 um"')
    cells: Annotated[int, Field(ge=4, le=1000)] = Field(description="a whole number, 4 or more")
    spacing: Literal["equal", "geometric"] = word("equal", "geometric", default="equal")


class CrystalliserTable(Table):
    """`type = "crystalliser"`"""

    type: Literal["crystalliser"]
    method: Literal["moments", "finite-volumes"] = word(
        "moments", "finite-volumes", default="moments"
    )
    sizes: dict | None = Field(None, description="the table sizes")
    solute: Text = Field(description="the name of a species")
    duration: Any = quantity('"7200 s"')
    temperature: Any = profile()
    initial_concentration: Any = quantity('"49 kg/m^3"', None)
    solubility: dict = Field(description="the table solubility")
    kinetics: dict = Field(description="the table kinetics")
    seed: dict = Field(description="the table seed")
    shape: Any = Field(description="a number above 0, such as 0.5236")
    density: Any = quantity('"1200 kg/m^3"')
    nuclei_size: Any = quantity('"1 um"', "0 m")
    separate: bool = Field(False, description="true or false")
    dosing: Any = profile(None)


class FilterTable(Table):
    """`type = "filter"`"""

    type: Literal["filter"]
    area: Any = quantity('"200 cm^2"')
    pressure: Any = quantity('"1 bar"')
    viscosity: Any = quantity('"0.46 mPa*s"')
    medium_resistance: Any = quantity('"1e10 1/m"')
    porosity: Any = Field(description="a share between 0 and 1")
    saturation: Any = Field(description="a share between 0 and 1")
    resistance: Any = quantity('"1e11 m/kg"', None)
    wash: Literal["exponential", "dispersion"] = word(
        "exponential", "dispersion", default="exponential"
    )
    wash_ratio: Any = Field(description="a number, 0 or more")
    efficiency: Any = Field(None, description="a number above 0")
    peclet: Any = Field(None, description="a number above 0")


class LiquidTable(Table):
    """`[units.NAME.liquid]`"""

    antoine: Annotated[list[float], Field(min_length=3, max_length=3)] = Field(
        description="three numbers, such as [9.23027, 1256.68, -40.529]"
    )
    unit: Text = Field("Pa", description='a unit such as "Pa"')
    scale: Literal["K", "degC"] = word("K", "degC", default="K")
    latent_heat: Any = quantity('"448 kJ/kg"')
    heat_capacity: Any = quantity('"1720 J/kg/K"')


class DryerTable(Table):
    """`type = "dryer"`"""

    type: Literal["dryer"]
    kind: Literal["falling-rate", "tray"] = word("falling-rate", "tray", default="falling-rate")
    duration: Any = quantity('"3 h"')
    temperature: Any = profile()
    rate: Any = quantity('"1e-3 1/s"', None)
    activation: Any = quantity('"40 kJ/mol"', None)
    reference_temperature: Any = quantity('"323.15 K"', None)
    reference_size: Any = quantity('"40 um"', None)
    pressure: Any = profile(None)
    area: Any = quantity('"0.5 m^2"', None)
    heat_transfer: Any = quantity('"20 W/m^2/K"', None)
    mass_transfer: Any = quantity('"7e-10 kg/m^2/s/Pa"', None)
    critical: Any = quantity('"0.03 kg/kg"', None)
    heat_capacity: Any = quantity('"1200 J/kg/K"', None)
    liquid: dict | None = Field(None, description="the table liquid")


class DissolutionTable(Table):
    """`type = "dissolution"`"""

    type: Literal["dissolution"]
    diffusivity: Any = quantity('"7e-10 m^2/s"')
    solubility: Any = quantity('"0.5 kg/m^3"')
    film: Any = quantity('"30 um"')
    time: Any = quantity('"30 min"')


class TankTable(Table):
    """`type = "tank"`"""

    type: Literal["tank"]
    inlets: Texts = Field(description='a list of names, such as ["first", "second"]')


class SplitterTable(Table):
    """`type = "splitter"`"""

    type: Literal["splitter"]
    outlets: Annotated[list[Text], Field(min_length=2)] = Field(
        description='a list of two names or more, such as ["left", "right"]'
    )
    share: Any = Field(description="shares of all outlets but the last, from 0 to 1")
