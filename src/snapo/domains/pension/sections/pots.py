"""Personal pots: each cohort's pension at the horizon, its changes, and the solidarity reserve."""

from collections.abc import Callable

import numpy as np

from snapo.report.page import Block, Facts, Missing, Section, Table, Text
from snapo.report.quantity import NONE, finite, number

from .run import PensionRun, points, share

CAVEAT = (
    "Pensions are nominal, for each member and year, under the learned policy. The pots of today"
    " share the assets less the reserve by the value of what each cohort has earned. A pot is"
    " credited with the return of its annuity on the path's curve on its share of protection and"
    " with that of cash on the rest, the reserve with that of cash; all other return, the excess,"
    " is shared by exposure. Cut: the share of years of payment in which the pension falls."
)


def pots(run: PensionRun) -> Section:
    """The pots of a fund that has them; nothing of others."""
    title, short = f"Personal pots ({run.measure})", "Pots"
    if not run.get("personal"):
        return Section("pots", title, short, [])
    found = run.get("pots")
    if not found:
        return Section("pots", title, short, [Missing("The pots were not worked out in this run.")])
    reserve = [finite(each[1]) for each in found["reserve"]]
    facts = [
        ("Pension today over that earned", share(found["level"]), "pots over annuities"),
        (
            "Solidarity reserve",
            share(reserve[0]),
            f"median {share(reserve[-1])} a year before the end",
        ),
        (
            "Into the reserve",
            run.large(found["filled"]),
            "mean over the horizon, from excess return",
        ),
        ("Out of it", run.large(found["released"]), "mean over the horizon, to restore pensions"),
    ]
    source = f"Rules from {found['since']}: {found['source']}."
    blocks: list[Block] = [Facts(facts), _cohorts(run, found)]
    return Section(
        "pots",
        title,
        short,
        [*blocks, *_reserve(run, found), Text(CAVEAT, True), Text(source, True)],
    )


def _cohorts(run: PensionRun, found: dict) -> Table:
    head = [("Cohort", ""), ("Pot", ""), ("Earned", run.currency), ("Today", run.currency)]
    head += [(f"{round(100 * q)} %", run.currency) for q in found["quantiles"]]
    head += [("Of salary", "%"), ("Volatility", "points"), ("Cut", "%"), ("By", "points")]

    def seen(value, places: int = 1) -> str:
        return NONE if finite(value) is None else points(value, places)

    rows = [
        (
            each["name"],
            run.large(each["pot"]),
            *(number(each[key], 0) for key in ("earned", "pension")),
            *(number(value, 0) for value in each["horizon"]),
            seen(each["of_salary"]),
            seen(each["volatility"]),
            seen(each["cut"]),
            seen(each["fall"]),
        )
        for each in found["cohorts"]
    ]
    return Table(head, rows, f"Pension of each member {run.horizon}, by cohort", 1)


def _reserve(run: PensionRun, found: dict) -> list[Block]:
    rows = np.asarray(found["reserve"], float)
    if len(rows) < 2:
        return []
    head = [("Year", ""), *((f"{round(100 * q)} %", "%") for q in found["quantiles"])]
    body = [
        (number(year, 0), *(points(value, 1) for value in row))
        for year, row in zip(found["years"], rows)
    ]
    return [Table(head, body, "The reserve as a share of all assets, at the starts of years", 1)]


def of_rights(section: Callable[[PensionRun], Section]) -> Callable[[PensionRun], Section]:
    """The section, without anything in it for a fund of pots, which its figures do not describe."""

    def told(run: PensionRun) -> Section:
        if run.get("personal"):
            return Section(section.__name__, "", "", [])
        return section(run)

    return told
