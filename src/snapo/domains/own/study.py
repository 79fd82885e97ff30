"""A run with a user-defined simulator: check, training, measurement and report."""

from collections.abc import Callable
from typing import Any

import jax

from snapo.case.error import CaseError, Unquoted, counted, nearest
from snapo.checker.check import check
from snapo.checker.findings import Findings
from snapo.checker.shapes import unknown_outputs
from snapo.problem.inputs import named_inputs
from snapo.problem.policy import MLP, Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at, probe
from snapo.problem.smooth import Exact
from snapo.solver.relaxations.stop import UNKNOWN, Relaxable, bounded, relaxation_of
from snapo.solver.solve import Evaluation
from snapo.solver.train import Training
from snapo.study.chapters.bound import BOUND
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import PROFILE, leaves
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.kind import inputs_line
from snapo.study.ready import at_values, with_auto
from snapo.study.study import Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .records import OwnCase


class SimulatorError(CaseError):
    """Mistakes in the simulator, with their files and lines."""

    def __init__(self, findings: Findings):
        self.findings = findings
        super().__init__(findings.simulator, "", None, str(findings))

    def __str__(self) -> str:
        return str(self.findings)


def checked(case: OwnCase) -> Findings:
    """The remarks of `snapo.check` on a simulator that can be used for training.

    **Raises:** `SimulatorError` if it cannot be used for training; `CaseError` if the case, or a
    limit of the class, refers to an output that does not exist.
    """
    findings = check(case.simulator, case.inputs)
    if not findings.ok:
        raise SimulatorError(findings)
    available = names(Problem(case.simulator, case.inputs, case.objective))
    there = f"the outputs of the simulator are {', '.join(available['outputs'])}"
    for key, output in case.outputs.items():
        if output not in available["outputs"]:
            raise CaseError(str(case.file), f"{key}.output", output, there)
    for mistake in unknown_outputs(case.objective, case.constraints, available["outputs"]):
        raise CaseError(":".join(case.location), mistake.of, Unquoted(mistake.got), there)
    every = [name for item in available.values() for name in item]
    for name in case.units:
        if name not in every:
            message = f"no state, action or output has this name; {nearest(name, every)}"
            raise CaseError(str(case.file), f"units.{name}", case.units[name], message)
    return findings


def names(problem: Problem) -> dict[str, tuple[str, ...]]:
    """The names of states, actions and outputs; only shapes are computed."""
    simulator, schedule = problem.simulator, problem.schedule

    def once(schedule, noise, action) -> Any:
        now = at(schedule.steps, 0)
        state = probe(simulator, schedule)[0]
        state = jax.tree.map(lambda leaf: jax.numpy.zeros(leaf.shape, leaf.dtype), state)
        after, outputs = simulator.step(schedule.constants, now, state, action, noise, Exact())
        return after, outputs | simulator.terminal(schedule.constants, after, Exact())

    noise, action = jax.numpy.zeros(simulator.noise_size), jax.numpy.zeros(simulator.action.size)
    state, outputs = jax.eval_shape(once, schedule, noise, action)
    states = tuple(name or "state" for name in leaves(state))
    return {"state": states, "action": ("action",), "outputs": tuple(outputs)}


def summary(case: OwnCase) -> list[str]:
    """The remarks on the simulator, and the case in a few lines."""
    return [str(checked(case)), *lines(case)]


def lines(case: OwnCase) -> list[str]:
    """The case in a few lines."""
    return [
        f"{case.title}: {counted(case.simulator.horizon, case.step)}, {':'.join(case.location)}",
        inputs_line([entry.value.size for entry in case.inputs.values()]),
        f"the {case.objective_words} is maximised",
    ]


def study(
    case: OwnCase,
    options: Options,
    setup_of: Callable[[OwnCase, str], Setup] | None = None,
) -> Study:
    """The parts of a run: training, distribution, fans, moves of the inputs, and the certificate.

    `setup_of`: makes the setup of a case with an engine, by default from the tables of the case.
    """
    if options.reference:
        message = "a user-defined simulator has no exact values to compute"
        raise CaseError("--reference", "", None, message)
    available = (options.about or {}).get("notes")
    notes = _notes(case) if available is None else available
    setup_of = setup_of or make_setup
    setup = setup_of(case, options.engine)
    chapters = (DISTRIBUTION, PROFILE, MOVES, CERTIFICATE)
    parts = [TRAINING, *(chapter.part for chapter in chapters)]
    if isinstance(setup.problem.simulator, Relaxable):
        parts.append(BOUND.part)
    about = {
        "title": case.title,
        "step": case.step,
        "unit": case.unit,
        "value_unit": case.unit,
        "units": dict(case.units),
        "horizon": case.simulator.horizon,
        "simulator": ":".join(case.location),
        "objective": case.objective_words,
        "objective_output": next(iter(case.outputs.values())),
        "notes": notes,
    }
    relaxation = _relaxation(setup.problem)

    def at_case(before: Setup, other: OwnCase) -> Setup:
        values = {name: inputs.value for name, inputs in other.inputs.items()}
        return at_values(before, other.simulator, values, lambda: setup_of(other, options.engine))

    return Study(
        "own",
        about,
        tuple(parts),
        _result,
        lambda: setup,
        relaxation,
        setup_at=at_case,
        inputs=lambda other: {item.name: item.input for item in named_inputs(other.inputs)},
    )


def _notes(case: OwnCase) -> list[str]:
    """Checks the simulator, and returns remarks on it and on the case."""
    warnings = (
        f"{warning.where}: {warning.subject} {warning.fix}" for warning in checked(case).warnings
    )
    return [*case.notes, *warnings]


def _result(run: StudyRun) -> dict[str, Any]:
    bounds = run.get(BOUND.key)
    return trained(run) | ({BOUND.key: bounds} if bounds else {})


def _relaxation(problem: Problem):
    """The inner problem of the upper bound, or the reason why a run has no such bound."""
    return (lambda: relaxation_of(problem)) if bounded(problem) else UNKNOWN


def make_setup(case: OwnCase, engine: str) -> Setup:
    """The problem with its policy and engines."""
    training = Training(**case.training.model_dump(exclude_none=True))
    evaluation = Evaluation(**case.evaluation.model_dump())
    sources = evaluation.sources(training.seed)
    problem = Problem(case.simulator, case.inputs, case.objective, sources, case.constraints)
    recipe = getattr(case.simulator, "policy", None) or MLP()
    if not isinstance(recipe, Policy):
        got = Unquoted(f"a {type(recipe).__name__}")
        raise CaseError(
            ":".join(case.location), "policy", got, "it must be a policy, such as snapo.MLP()"
        )
    return with_auto(engine, problem, recipe, training, evaluation)
