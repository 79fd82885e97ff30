"""The time and memory of `snapo solve` for a battery over a year by the hour, 8,760 steps.

    python -m benchmarks.year_by_hour

The battery and the settings are those of the template; the price curve has a daily, a weekly and a
yearly shape. The program prints the value, the wall and processor seconds and the peak memory of
the whole command, which runs in a separate process. At most 300 seconds on two idle cores, and 2
GB, are required.
"""

import datetime as dt
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

START, END = dt.datetime(2026, 5, 1), dt.datetime(2027, 5, 1)
SECONDS, GIGABYTES = 300.0, 2.0
OF_DAY = (
    0.72, 0.68, 0.65, 0.64, 0.66, 0.75, 0.95, 1.18, 1.28, 1.15, 1.00, 0.92,
    0.86, 0.82, 0.84, 0.92, 1.05, 1.25, 1.45, 1.42, 1.25, 1.05, 0.90, 0.78,
)  # fmt: skip


def price(hour: dt.datetime) -> float:
    """The forward price of an hour: high in winter and evenings, low at weekends and noon."""
    day = hour.timetuple().tm_yday
    season = 1 + 0.15 * math.cos(2 * math.pi * (day - 20) / 365)
    light = 0.25 * max(0.0, math.cos(2 * math.pi * (day - 172) / 365))
    sun = light * math.exp(-(((hour.hour - 13) / 2.5) ** 2))
    return 80 * season * OF_DAY[hour.hour] * (0.85 if hour.weekday() >= 5 else 1.0) * (1 - sun)


def make_case(folder: Path) -> None:
    """Writes the template's case with the dates and the price curve of the year."""
    subprocess.run([sys.executable, "-m", "snapo", "new", "battery", str(folder)], check=True)
    file = folder / "case.toml"
    text = file.read_text("utf-8")
    keys = ("start", START.isoformat()), ("end", END.isoformat()), ("valuation_date", START.date())
    for key, value in keys:
        text = re.sub(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
    file.write_text(text, "utf-8")
    hours = [
        START + dt.timedelta(hours=k) for k in range(int((END - START).total_seconds() / 3600))
    ]
    rows = [f"{hour:%Y-%m-%dT%H:%M},{price(hour):.4f}" for hour in hours]
    (folder / "curve.csv").write_text("\n".join(["time,price", *rows]) + "\n", "utf-8")


def main() -> None:
    """Makes and solves the case, and prints the row."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "year"
        make_case(folder)
        began = time.perf_counter()
        command = [sys.executable, "-m", "snapo", "solve", str(folder)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        printed = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - began
    if process.returncode:
        sys.exit(printed)
    value = re.search(r"(?m)^value +(.*)$", printed)
    gigabytes = usage.ru_maxrss * 1024 / 1e9
    print("| value | wall s | processor s | peak GB | within |")
    print("|---|---|---|---|---|")
    within = "yes" if wall <= SECONDS and gigabytes <= GIGABYTES else "no"
    figures = f"{wall:.0f} | {usage.ru_utime + usage.ru_stime:.0f} | {gigabytes:.2f} | {within}"
    print(f"| {value.group(1).strip() if value else '-'} | {figures} |")


if __name__ == "__main__":
    main()
