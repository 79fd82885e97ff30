"""A case of the shop: how it is read, what a run does, and how it is told."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from pydantic import Field
from scipy.stats import lognorm

import snapo
from snapo.case.settings import EvaluationTable, TrainingTable, read_evaluation, read_training
from snapo.case.table import CaseTable, Count, Positive, parse
from snapo.engine import choose
from snapo.report.evidence import history, making
from snapo.report.folder import RunFiles
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.headline import headline
from snapo.study.chapters.profile import PROFILE
from snapo.study.chapters.sensitivities import MOVES, sensitivities
from snapo.study.domain import Options, Report
from snapo.study.study import Part, Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .shop import Shop


class ShopTable(CaseTable):
    """`[shop]`; a key that is not here is an error with its name."""

    days: Count = Field(description="a whole number, 1 or more")
    stock: float = Field(description="a number of pieces")
    demand: Positive = Field(description="a number of pieces above 0")
    volatility: Positive = Field(description="a number above 0")
    price: Positive = Field(description="a number above 0, EUR a piece")
    cost: Positive = Field(description="a number above 0, EUR a piece")
    holding: Positive = Field(description="a number above 0, EUR a piece and day")
    shortage: Positive = Field(description="a number above 0, EUR a piece and day")


class CaseTable(CaseTable):
    """The whole file."""

    kind: str
    title: str = Field("A shop", description="text")
    shop: dict[str, Any] = Field(description="a table, [shop]")
    training: dict[str, Any] = Field({}, description="a table, [training]")
    evaluation: dict[str, Any] = Field({}, description="a table, [evaluation]")


@dataclass(frozen=True)
class Case:
    """A case that was read."""

    file: Path
    notes: tuple[str, ...]
    title: str
    shop: ShopTable
    training: TrainingTable
    evaluation: EvaluationTable


# Of every input: its unit, by how much reports move it, and what it means.
INPUTS = {
    "stock": ("pieces", 1.0, "at the start"),
    "demand": ("pieces/day", 1.0, "mean of a day"),
    "volatility": ("1", 0.01, "of the logarithm of the demand"),
    "price": ("EUR", 0.1, "of a piece sold"),
    "cost": ("EUR", 0.1, "of a piece ordered"),
    "holding": ("EUR/day", 0.01, "of a piece kept overnight"),
    "shortage": ("EUR/day", 0.1, "of a customer who waits overnight"),
}
UNITS = {"stock": "pieces", "profit": "EUR", "owed": "pieces", "action": "mean demands"}


def read_case(file: Path, data) -> Case:
    table = parse(CaseTable, data, str(file), "")
    return Case(
        file,
        (),
        table.title,
        parse(ShopTable, table.shop, str(file), "shop"),
        read_training(table.training, str(file)),
        read_evaluation(table.evaluation, str(file)),
    )


def level(shop: ShopTable) -> float:
    """The stock to order up to: the quantile shortage / (shortage + holding) of a day's demand."""
    share = shop.shortage / (shop.shortage + shop.holding)
    scale = shop.demand * np.exp(-(shop.volatility**2) / 2)
    return float(lognorm(s=shop.volatility, scale=scale).ppf(share))


def lines(case: Case) -> list[str]:
    return [
        f"{case.title}: {case.shop.days} days, {case.shop.demand:g} pieces a day",
        f"the best rule orders up to {level(case.shop):.1f} pieces",
    ]


def study(case: Case, options: Options) -> Study:
    setup = make_setup(case, options.engine)
    chapters = (DISTRIBUTION, PROFILE, MOVES, CERTIFICATE)
    parts = [TRAINING, *(chapter.part for chapter in chapters)]
    if options.reference:
        parts.append(Part("best rule", lambda run: best_rule(run, case)))

    def result(run: StudyRun):
        return trained(run, {"best_rule": run.get("best_rule.value")})

    about = {
        "title": case.title,
        "unit": "EUR",
        "units": UNITS,
        "step": "day",
        "horizon": case.shop.days,
        "objective": "mean profit",
        "objective_output": "profit",
        "level": level(case.shop),
    }
    return Study("newsvendor", about, parts, result, lambda: setup)


def make_setup(case: Case, engine: str) -> Setup:
    inputs = {
        name: snapo.Input(getattr(case.shop, name), unit, move=move, meaning=words)
        for name, (unit, move, words) in INPUTS.items()
    }
    training = snapo.Training(**case.training.model_dump(exclude_none=True))
    evaluation = snapo.Evaluation(**case.evaluation.model_dump())
    sources = evaluation.sources(training.seed)
    simulator = Shop(horizon=case.shop.days)  # pyright: ignore[reportCallIssue]
    problem = snapo.Problem(simulator, inputs, "profit", sources)
    key = jax.random.key(training.seed)
    policy = snapo.MLP().for_problem(problem.interface, key)
    return Setup(problem, policy, training, evaluation, choose(engine, problem, policy))


def best_rule(run: StudyRun, case: Case) -> dict[str, Any]:
    """The value of ordering up to the level of the theory, on the paths of the evaluation."""
    problem, engines = run.setup.problem, run.setup.engines
    evaluation = run.setup.evaluation
    rule = snapo.BaseStock(level(case.shop) / case.shop.demand)
    found = snapo.evaluate(problem, rule, paths=evaluation.paths, engine=engines.evaluate)
    return {"best_rule": {"value": found.value, "standard_error": found.standard_error}}


def about(run: RunFiles) -> list[tuple[str, str]]:
    return [("Days", str(run.get("horizon"))), ("Best level", f"{run.get('level'):.1f} pieces")]


SECTIONS = (headline, sensitivities, DISTRIBUTION, PROFILE, history, CERTIFICATE, making)
REPORT = Report("A shop", RunFiles, about, SECTIONS)
