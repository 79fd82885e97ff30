"""`decisions.csv` of a run: the first day's decision by spot price and inventory."""

import csv
import json

import numpy as np
import pytest

pytestmark = pytest.mark.prove


def test_every_run_has_today_s_decisions_by_price_and_inventory(solved):
    run = solved("gas-storage") / "run"
    with (run / "decisions.csv").open() as stream:
        head, *rows = csv.reader(stream)
    assert head[0] == "date" and head[1].startswith("spot (") and head[4].startswith("withdrawal (")
    spot, stock, into, out = np.array([row[1:] for row in rows], float).T
    assert len(np.unique(spot)) == 21 and np.all(into * out == 0)
    today = json.loads((run / "parts" / "profile.json").read_text())["today"]
    # At the forward price, which stands in the middle, it is the ladder's decision.
    middle = np.isclose(spot, today["spot"])
    ladder = {row["inventory"]: row for row in today["ladder"]}
    for level, net in zip(stock[middle], (into - out)[middle]):
        row = ladder[float(level)]
        sign = {"inject": 1, "withdraw": -1, "hold": 0}[row["action"]]
        np.testing.assert_allclose(net, sign * row["volume"], rtol=1e-9, atol=1e-9)
    # Dearer gas is never a reason to inject more.
    for level in np.unique(stock):
        here = stock == level
        assert np.all(np.diff((into - out)[here][np.argsort(spot[here])]) <= 1e-6)
