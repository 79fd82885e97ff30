"""A run of a pharma case: one part for every table that its report shows."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.chain import Chain
from snapo.solver.provenance.versions import versions
from snapo.study import choice
from snapo.study.domain import Options
from snapo.study.run_folder import case_files
from snapo.study.study import Measured, Part, Shown, Study, StudyRun

from .control.parts import ClosedLoop
from .control.stages import Stage
from .flowsheet.case import PharmaCase
from .flowsheet.inputs import pharma_inputs
from .flowsheet.process import Process
from .progress import told
from .quality.limits import Limits
from .quality.sampling import on_steps, sampler
from .read.fitted import COLUMNS as FITTED_COLUMNS
from .results import batch, derivatives, quality, setpoints
from .results.checks import status
from .results.moved import Recipe, limits
from .results.statement import statement

COLUMNS = (
    ("attribute", ""), ("limits", ""), ("mean of batches", ""), ("standard deviation", ""),
    ("within limits", "%"), ("± standard error", "%"),
)  # fmt: skip


def case_of(simulator: Any) -> PharmaCase:
    """The case of a loop's simulator."""
    stage = simulator.stages[0] if isinstance(simulator, Chain) else simulator
    assert isinstance(stage, Stage)
    return stage.case


def kept_limits(found: Measured) -> Sequence[Shown]:
    """Every attribute with its limits, and how often batches keep them under the policy."""
    case = case_of(found.setup.problem.simulator)
    names = [f"attribute.{each.name}" for each in case.attributes]
    values = np.stack([np.asarray(found.totals[name], np.float64) for name in names], -1)
    holds = Limits.of(case).hold(values)
    rows = []
    for i, each in enumerate(case.attributes):
        share, error = found.mean(holds[:, i])
        mean, spread = values[:, i].mean(), values[:, i].std(ddof=1)
        bounds = limits(each.low, each.high, each.unit)
        rows.append((each.name, bounds, mean, spread, 100 * share, 100 * error))
    share, error = found.mean(found.totals["success"])
    words = f"{100 * share:.4g} % ± {100 * error:.2g} % of batches keep all limits"
    return [Shown("Attributes and their limits", COLUMNS, rows, words)]


def result(case: PharmaCase, run: StudyRun) -> dict[str, Any]:
    """The value is that of the policy, or of the recipe as it stands."""
    capable, loop = run.get("capability", {}), run.get("closed_loop", {})
    recipe = 1 - capable["joint"] if capable else None
    found: dict[str, Any] = {
        "value": recipe,
        "standard_error": capable.get("joint_error"),
        "meaning": "probability that a batch keeps all limits, by the recipe as given",
        "references": {},
        "engine": "none: no policy is trained",
        "paths": {"evaluate": capable.get("batches", 0)},
        "seed": case.training.seed,
        "status": status(run),
    }
    best = run.get("optimise")
    if best:
        found["references"] = {"optimised_recipe": best["chance"][1]["probability"]}
    if not loop:
        return found
    references = {"recipe_as_given": loop["given"], "best_fixed_recipe": loop["baseline"]}
    references |= found["references"]
    if case.goal.kind != "probability":
        references |= {"goal": loop["objective"], "goal_of_recipe": loop["baseline_objective"]}
    found |= {key: loop[key] for key in ("value", "standard_error", "engine", "paths")}
    if found["status"] == "ok":
        found["status"] = loop["status"]
    meaning = "probability that a batch keeps all limits, under the trained policy"
    return found | {"references": references, "meaning": meaning, "verdict": verdict(loop)}


def verdict(loop: Mapping[str, Any]) -> str:
    """Which rival is to be taken, in a sentence."""
    both = f"{100 * loop['value']:.1f} % under the policy, {100 * loop['baseline']:.1f} % under "
    both += "the best fixed recipe, on the same batches"
    match loop["better"]:
        case "policy":
            return f"The policy does better than the best fixed recipe: {both}."
        case "recipe":
            return f"The best fixed recipe does better than the policy: {both}. Take the recipe."
        case _:
            return f"The policy is not told from the best fixed recipe: {both}."


PROFILE, FITTED = "profile.csv", "fitted.csv"
SPACE, BOUNDARY = "design_space.csv", "design_space_boundary.csv"
SETPOINTS, BEST = "setpoints.csv", "setpoints_best.csv"
SLOPES = "attribute_sensitivities.csv"  # of the attributes; a policy has a table of its own

BATCH, SOUND, MATRIX, MESH = "one batch", "integration", "sensitivity matrix", "mesh of statistics"
RANGES = "proven ranges"


def study(case: PharmaCase, options: Options) -> Study:
    """The recipe as it stands, then, where there is something to decide, the closed loop."""
    if options.reference:
        what = "a process has no exact reference to compute; its certificate is part of every run"
        raise CaseError("--reference", "", None, what)
    parts: list[Part] = list(OpenLoop(case).parts())
    hooks: dict[str, Any]
    if case.control is not None:
        loop = ClosedLoop(case, options.engine)
        parts = [*parts, *loop.parts()]
        hooks = {"setup": loop.setup, "moved": loop.moved, "shown": kept_limits}
    else:
        hooks = {"recalculated": lambda: Recipe(case)}
    kept = choice.chosen(parts, case.parts)
    known = about(case) | choice.told(parts, kept)
    telling, said = [_telling(part) for part in kept], partial(result, case)
    return Study(case.kind, known, telling, said, inputs=pharma_inputs, **hooks)


def _telling(part: Part) -> Part:
    """The part, with lines of progress while it lasts."""

    def work(run: StudyRun) -> Mapping[str, Any]:
        with told(run.tell):
            return part.work(run)

    return part._replace(work=work)


def about(case: PharmaCase) -> dict[str, Any]:
    """Everything that is known before a number is computed."""
    files = {each.name: each.read_bytes() for each in case_files(case.file.parent)}
    found = {
        "title": case.title,
        **statement(case),
        "notes": list(case.notes),
        "libraries": _libraries(),
        "hashes": {name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
    }
    if case.control is None:  # else the training says them
        found |= {"versions": versions(), "seed": case.training.seed}
    return found


def _libraries() -> dict[str, str]:
    found = {}
    for name in ("diffrax", "pint", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


class OpenLoop:
    """The parts of the recipe as it stands; they share a process, compiled once."""

    def __init__(self, case: PharmaCase):
        self.case, self.seed = case, case.training.seed
        self._sampled: Process | None = None

    @cached_property
    def process(self) -> Process:
        return Process(self.case)

    def sampled(self, run: StudyRun) -> Process:
        """The process for statistics, on the mesh that was found to do for them."""
        if self._sampled is None:
            steps = int(run.get("sampling.steps", self.process.case.numerics.steps))
            self._sampled = on_steps(self.process, steps)
        return self._sampled

    def parts(self) -> Sequence[Part]:
        """In the order in which they are done."""
        found = [Part(BATCH, self.one_batch), Part(SOUND, self.sound, (BATCH,))]
        return [*found, *self.checked(), *self.derivatives(), *self.statistics()]

    def of(self, name: str, key: str, make: Callable[[Process], Any], *needs: str) -> Part:
        """A part with one table, made of the process, once it is known that it can be solved."""
        return Part(name, lambda run: {key: make(self.process)}, (SOUND, *needs))

    def one_batch(self, run: StudyRun) -> dict[str, Any]:
        found = self.process.run()
        table = batch.one_batch(self.process.case, found)
        run.write_csv(SETPOINTS, setpoints.HEADER, setpoints.setpoints(self.case))
        if found.status == "ok":
            header = ("unit", "time_s", "state", "value", "state_unit")
            run.write_csv(PROFILE, header, batch.profile_rows(self.case, table))
        return {"run": table}

    def sound(self, run: StudyRun) -> dict[str, Any]:
        """Nothing else can be found out about a batch that could not be integrated."""
        if run.get("run.status") != "ok":
            raise ArithmeticError(run.get("run.status"))
        return {}

    def checked(self) -> list[Part]:
        """Whether the numbers can be believed."""
        found = [self.of("balances", "balances", lambda p: batch.balance_rows(p))]
        if self.case.numerics.refine:
            found.append(
                self.of("convergence", "convergence", lambda p: derivatives.convergence_rows(p))
            )
        certificate = self.of(
            "certificate", "certificate", lambda p: derivatives.certificate_rows(p, self.seed)
        )
        return [*found, certificate]

    def derivatives(self) -> list[Part]:
        """What every attribute depends on."""
        found = [
            self.of(MATRIX, "matrix", lambda p: derivatives.matrix_tables(p)),
            Part("all sensitivities", self.slopes, (SOUND,)),
            Part("attribution", self.attribution, (MATRIX,)),
            self.of(
                "profile sensitivities", "profiles",
                lambda p: derivatives.profile_gradients(self.case),
            ),
        ]  # fmt: skip
        if self.case.pairs:
            second = self.of("second derivatives", "second", lambda p: derivatives.second_rows(p))
            found.append(second)
        return found

    def slopes(self, run: StudyRun) -> dict[str, Any]:
        header = ("attribute", "input", "label", "value", "unit")
        run.write_csv(SLOPES, header, derivatives.every_sensitivity(self.process))
        return {}

    def attribution(self, run: StudyRun) -> dict[str, Any]:
        return {"attribution": derivatives.attribution_rows(self.process, run.get("matrix"))}

    def statistics(self) -> list[Part]:
        """What holds over batches that differ."""
        case, seed = self.case, self.seed

        def of(name: str, key: str, make: Callable[[Process], Any]) -> Part:
            return Part(name, lambda run: {key: make(self.sampled(run))}, (MESH,))

        found = [
            Part(MESH, self.mesh, (SOUND,)),
            of("capability", "capability", lambda p: quality.capability_rows(p, seed + 1)),
            of("criticality", "criticality", lambda p: quality.criticality_rows(p, seed + 3)),
            Part("spread", self.spread, (MATRIX,)),
        ]
        if case.optimise is not None:
            found.append(Part("best recipe", self.best_recipe, (MESH,)))
        if case.design_space is not None:
            found.append(Part("design space", self.design_space, (MESH,)))
            found.append(of(RANGES, "ranges", lambda p: quality.range_rows(p, seed)))
            found.append(Part("pairs of ranges", self.pairs, (RANGES,)))
        if case.estimation is not None:
            found.append(Part("estimation", self.fit, (SOUND,)))
        return found

    def fit(self, run: StudyRun) -> dict[str, Any]:
        found = quality.estimation_rows(self.process)
        rows = quality.fitted_rows(self.case, found)
        if rows:
            run.write_csv(FITTED, FITTED_COLUMNS, rows)
        return {"estimation": found}

    def mesh(self, run: StudyRun) -> dict[str, Any]:
        self._sampled, found = sampler(self.process)
        return {"sampling": found}

    def spread(self, run: StudyRun) -> dict[str, Any]:
        return {"spread": quality.spread_rows(self.case, run.get("matrix"))}

    def best_recipe(self, run: StudyRun) -> dict[str, Any]:
        sampled = self.sampled(run)
        found, ask = quality.best_recipe(self.process, sampled, self.seed), self.case.optimise
        if ask is not None and found["converged"]:
            changed = setpoints.optimal(ask, found)
            run.write_csv(BEST, setpoints.HEADER, setpoints.setpoints(self.case, changed))
        return {"optimise": found}

    def design_space(self, run: StudyRun) -> dict[str, Any]:
        found = quality.map_tables(self.sampled(run), self.seed)
        names = [each.name for each in self.case.attributes]
        run.write_csv(SPACE, *quality.space_rows(found, names))
        run.write_csv(BOUNDARY, *quality.boundary_rows(found, names))
        return {"design_space": found}

    def pairs(self, run: StudyRun) -> dict[str, Any]:
        return {"pairs": quality.pair_rows(self.sampled(run), run.get("ranges"), self.seed)}
