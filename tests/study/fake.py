"""A domain of a few lines: sums of numbers, with parts that can be told to fail."""

from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from snapo.case.error import CaseError
from snapo.report.folder import RunFiles
from snapo.report.page import Section, Text
from snapo.study import domain as domains
from snapo.study.domain import Options, Report
from snapo.study.study import Part, Study, StudyRun

DONE: list[str] = []  # the parts that were worked out, in order


@dataclass(frozen=True)
class FakeCase:
    file: Path
    numbers: list[float]
    fails: str
    notes: tuple[str, ...] = ("a remark",)


@dataclass(frozen=True)
class Fake:
    kind: str = "fake"
    description: str = "sums of numbers"
    templates: dict[str, Any] = field(default_factory=dict)

    def read(self, file, data) -> FakeCase:
        known = ("kind", "numbers", "fails", "training", "items")
        for key in data:
            if key not in known:
                raise CaseError(str(file), key, data[key], "there is no such key")
        numbers = data.get("numbers", [1.0, 2.0])
        if not isinstance(numbers, list):
            raise CaseError(str(file), "numbers", numbers, "it must be a list of numbers")
        return FakeCase(file, numbers, data.get("fails", ""))

    def check(self, case) -> list[str]:
        return [f"{len(case.numbers)} numbers"]

    def study(self, case, options: Options) -> Study:
        if options.reference:
            raise CaseError("--reference", "", None, "sums have no references")
        about = {"title": "Sums", "notes": list(case.notes)}
        return Study("fake", about, parts(case.numbers, case.fails), result)

    def report(self) -> Report:
        return Report("Fake", RunFiles, lambda run: [("Numbers", "some")], [section])

    def bench(self, engine, tell) -> str:
        return f"{engine}: at once"


def parts(numbers, fails: str = "") -> list[Part]:
    """Three parts; the second needs the first, the third stands alone."""

    def total(run: StudyRun):
        _start("first sum", fails)
        return {"sums": {"total": sum(numbers)}}

    def doubled(run: StudyRun):
        _start("doubled", fails)
        return {"doubled": 2 * run.get("sums.total")}

    def alone(run: StudyRun):
        _start("alone", fails)
        return {"alone": len(numbers)}

    return [
        Part("first sum", total),
        Part("doubled", doubled, ("first sum",)),
        Part("alone", alone),
    ]


def _start(name: str, fails: str) -> None:
    DONE.append(name)
    if name == fails:
        raise ZeroDivisionError(f"{name} was told to fail")


def result(run: StudyRun) -> dict[str, Any]:
    return {"value": run.get("sums.total"), "standard_error": 0.0}


def section(run: RunFiles) -> Section:
    text = f"total {run.get('sums.total')}, doubled {run.get('doubled')}, alone {run.get('alone')}"
    return Section("sums", "Sums", "Sums", [Text(text)])


DOMAIN = Fake()


def install(monkeypatch: pytest.MonkeyPatch, **values: str) -> None:
    """Entry points {kind: value} in place of those of installed packages."""
    found = [EntryPoint(name, value, domains.GROUP) for name, value in values.items()]
    monkeypatch.setattr(domains, "entry_points", lambda group: found)
    domains.installed.cache_clear()
