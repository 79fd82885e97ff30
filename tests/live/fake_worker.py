"""A worker that computes nothing: it answers as the real one does, and dies when it is told to."""

import json
import os
import sys
from pathlib import Path


def say(**message):
    print(json.dumps(message), flush=True)


base = {"value": {"value": 2.0, "standard_error": 0.5}}
say(stage="ready", inputs=[], choices=[], base=base, counts={"value": 2}, unit="", units={})
for line in sys.stdin:
    order = json.loads(line)
    address = {"page": order["page"], "n": order["n"]}
    if order["do"] == "write":
        Path(order["folder"]).mkdir(parents=True, exist_ok=True)
        name = "case.xlsx" if order.get("workbook") else "case.toml"
        Path(order["folder"], name).write_text('kind = "x"\n')
        say(**address, stage="written", folder=order["folder"])
        continue
    if "die" in order["values"]:
        # A file is left behind so that the next life answers.
        mark = Path(sys.argv[1])
        if not mark.exists():
            mark.touch()
            os._exit(9)
    say(**address, stage="value", seconds=0.0, table={"value": 1.0, "standard_error": 0.1})
    say(**address, stage="done", seconds=0.0)
