"""A worker for tests of the page in a browser: it computes a plain formula, at once or when told.

The value is 100 + 2 p² + 3 (p2 + p3) + cost of the inputs `price` (p, p2, p3) and `cost`; the
derivative with respect to the first price is 4 p. A cost above 100 is refused. While the file that
its argument names exists, it does not answer.
"""

import json
import queue
import sys
import threading
import time
from pathlib import Path

HELD = Path(sys.argv[1])
RUN = {"price": [10.0, 20.0, 30.0], "cost": [5.0]}


def say(**message):
    print(json.dumps(message), flush=True)


def value_of(values, chosen, policy=0):
    (p, *others), (cost,) = values["price"], values["cost"]
    bonus = 50.0 * (chosen.get("item.unmet") == "waits") + 7.0 * bool(policy)
    return 100 + 2 * p * p + 3 * sum(others) + cost + bonus


def deltas(values):
    slopes = {"price": [4 * values["price"][0], 3.0, 3.0], "cost": [1.0]}
    for name, numbers in slopes.items():
        rows = [
            {"label": f"m{i + 1}" if len(numbers) > 1 else "", "value": x, "low": x, "high": x}
            for i, x in enumerate(numbers)
        ]
        yield {"input": name, "effect": numbers[0], "low": 0.9 * numbers[0], "high": numbers[0],
               "rows": rows}  # fmt: skip


def stages(values, chosen, policy=0):
    numbers = {**RUN, **values}
    value, base = value_of(numbers, chosen, policy), value_of(RUN, {})
    yield "value", {"value": value, "standard_error": 0.5, "paths": 64, "change": value - base,
                    "change_error": 0.25, "predicted": 0.0, "by_input": {}}  # fmt: skip
    rows = [["fill rate, %", value / 10, 0.1]]
    yield "sections", [{"title": "Service", "description": "", "rows": rows,
                        "facts": [["yield", value / 10, "%"], ["temperature", 40.5, "degC"]],
                        "columns": [["", ""], ["mean", ""], ["±", ""]]}]  # fmt: skip
    yield "deltas", list(deltas(numbers))
    facts = [["stock", value / 100, "t"]]
    yield "today", {"description": f"order {value:.0f} t", "facts": facts, "columns": [],
                    "rows": []}  # fmt: skip
    line = [value, value + 1]
    series = (
        ("stock", "state"),
        ("weights.0", "state"),
        ("action", "action"),
        ("stock", "outputs"),
    )
    lines = [[x + i for x in line] for i in range(len(series))]
    yield "fans", [{"name": name, "kind": kind,
                    **dict.fromkeys(("mean", "p05", "p25", "p75", "p95"), line)}
                   for (name, kind), line in zip(series, lines)]  # fmt: skip


HEALTH = {"gradient": 1.0, "noise": 0.1, "at_training": 1.0}


def described(name, numbers, slope):
    labels = [f"m{i + 1}" for i in range(len(numbers))] if len(numbers) > 1 else [""]
    return {"name": name, "words": f"the {name}", "group": "price", "unit": "EUR/t",
            "trade_unit": "", "factor": 1.0, "values": numbers, "shape": [len(numbers)],
            "handles": [{"label": label, "at": [i]} for i, label in enumerate(labels)],
            "move": 1.0, "slope": slope, "source": ""}  # fmt: skip


INPUTS = [
    described("price", RUN["price"], [40.0, 3.0, 3.0]),
    described("cost", RUN["cost"], [1.0]),
]
CHOICES = [
    {"name": "item.unmet", "key": ["item", "unmet"], "value": "lost", "allowed": ["lost", "waits"],
     "title": "Item: unmet"}
]  # fmt: skip


def answer(order):
    """The lines that follow an order."""
    address, values = {"page": order["page"], "n": order["n"]}, order.get("values", {})
    if order["do"] == "write":
        if "price" in values:
            return [{**address, "stage": "refused", "message": "openpyxl is missing"}]
        Path(order["folder"]).mkdir(parents=True, exist_ok=True)
        Path(order["folder"], "case.toml").write_text('kind = "x"\n')
        return [{**address, "stage": "written", "folder": order["folder"]}]
    if order["do"] == "train":
        steps = {"step": 0, "of": 9}
        result = {"value": 1.0, "standard_error": 0.5, "gain": 7.0, "gain_error": 0.1,
                  "steps": 9, "status": "trained", "policy": 1}  # fmt: skip
        return [{**address, "stage": "training", "table": steps},
                {**address, "stage": "trained", "table": result}]  # fmt: skip
    if order["do"] == "explain":
        rows = [{"names": ["price"], "change": 600.0, "error": 20.0},
                {"names": ["cost"], "change": -2.0, "error": 0.0}]  # fmt: skip
        return [{**address, "stage": "explained", "table": rows}]
    if values.get("cost", [0])[0] > 100:
        return [{**address, "stage": "refused", "message": "cost: the limits allow 0 to 100"}]
    tables = stages(values, order.get("chosen", {}), order.get("policy", 0))
    lines = [{**address, "stage": name, "seconds": 0.0, "table": table} for name, table in tables]
    done = {**address, "stage": "done", "seconds": 0.0}
    return [*lines, done, {**address, "stage": "health", "table": HEALTH}]


def main():
    orders: queue.Queue = queue.Queue()

    def read():
        for line in sys.stdin:
            orders.put(json.loads(line))
        orders.put(None)

    threading.Thread(target=read, daemon=True).start()
    base = {**dict(stages({}, {})), "health": HEALTH}
    say(stage="ready", inputs=INPUTS, choices=CHOICES, base=base, counts={"value": 64},
        bounded=True, unit="EUR", units={"stock": "t"},
        names={"weights.0": "Equities, share of the assets"})  # fmt: skip
    while (order := orders.get()) is not None:
        while HELD.exists():
            time.sleep(0.02)
        if order["do"] != "cancel":
            for line in answer(order):
                say(**line)


if __name__ == "__main__":
    main()
