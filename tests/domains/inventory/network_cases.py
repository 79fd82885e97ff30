"""One place as an item and as a network, and small networks, for tests."""

from pathlib import Path
from typing import Any

import jax

from snapo.domains.inventory.item.records import InventoryCase
from snapo.domains.inventory.network.records import NetworkCase
from snapo.domains.inventory.network.simulator import NetworkSimulator
from snapo.domains.inventory.read.case import read_case
from snapo.domains.inventory.read.network import read_network

HERE = Path(__file__).parent


def network(*places: dict[str, Any], folder: Path = HERE, **tables: Any) -> NetworkCase:
    """A case with these places, and other tables by their names."""
    data = {"kind": "inventory", "place": list(places), **tables}
    return read_network(folder / "case.toml", data)


def one_place(
    demand: dict[str, Any], folder: Path = HERE, season: str = "", **place: Any
) -> tuple[InventoryCase, NetworkCase]:
    """The same item as a case of its own and as a network of one place, with the same start.

    - `season`: the name of its file; `place`: keys of both; `horizon`, `training`: tables.
    """
    tables = {name: place.pop(name) for name in ("horizon", "training") if name in place}
    unmet = place.pop("unmet", "waits")
    given = {"lead_time": 2, "holding": 1.0, "shortage": 9.0} | place
    more = {"season": {"file": season}} if season else {}
    whole = network({"name": "shop", "demand": demand, **more, **given}, folder=folder,
                    network={"unmet": unmet}, **tables)  # fmt: skip
    with jax.enable_x64(True):
        stock, coming = NetworkSimulator.of(whole).start()
    # An item's stock has the arrival of this morning in it; in a network it is still on its way.
    arrived = float(coming[0, 0]) if coming.shape[1] else 0.0
    item = given | {"unmet": unmet, "stock": float(stock[0]) + arrived,
                    "coming": [float(x) for x in coming[0, 1:]]}  # fmt: skip
    data = {"kind": "inventory", "item": item, "demand": demand, **more, **tables}
    return read_case(folder / "case.toml", data), whole
