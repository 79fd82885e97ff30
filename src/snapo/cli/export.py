"""`snapo export RUN`: the policy of a run as ONNX, as a Python file, or as a table of decisions."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import CaseError
from snapo.engine import Xla
from snapo.problem.carry.export import decided, to_onnx
from snapo.problem.carry.python import to_python
from snapo.problem.carry.save import PolicyFileError, load, stored
from snapo.problem.policies.memory import remembered, remembering
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import Exact
from snapo.solver.evaluate import named_series
from snapo.solver.solution import POLICY, folder_of
from snapo.solver.tables import write_csv
from snapo.study import run_folder
from snapo.study.commands import domain_of_run
from snapo.study.prepare import case_of_run, options_of_run
from snapo.study.study import Setup
from snapo.study.training import no_policy

ROWS = 1000  # of the table, at least


def export(
    run: Path,
    onnx: bool = False,
    table: bool = False,
    python: bool = False,
    simulator: tuple[str, str] | None = None,
) -> dict[str, Path]:
    """Writes the policy of a run into its folder; returns the files by form.

    - `onnx`: policy.onnx; `python`: policy.py, which needs only NumPy; `table`: policy.csv, the
      decisions at the observations of the first paths on which the policy is valued.

    **Raises:** `CaseError` if there is no run or it has no policy, no form is specified, a package
    is missing, or the policy cannot be exported.
    """
    run = folder_of(run)
    record = run_folder.read(run)
    if not (onnx or table or python):
        message = "specify one or more of --onnx, --python and --table"
        raise CaseError("snapo export", "", None, message)
    if not (run / POLICY).is_file():
        raise no_policy(run, record)
    try:
        content = stored(run / POLICY, Policy)
        policy, observed, setup = content.policy, content.features, None
        if table or policy is None:
            setup = _setup(run, record, simulator)
            policy = policy or load(run / POLICY, Policy, setup.policy)
            observed = setup.problem.interface.features
        if observed is not None:
            observed += remembered(policy)
        files = {}
        if onnx:
            files["onnx"] = run / run_folder.ONNX
            to_onnx(policy, files["onnx"], features=observed)
        if python:
            files["python"] = run / run_folder.PYTHON
            to_python(policy, files["python"], features=observed)
        if setup is not None and table:
            files["table"] = run / run_folder.DECIDED
            write_csv(files["table"], *decisions_on_paths(setup.problem, policy))
        return files
    except PolicyFileError as error:
        message = str(error).removeprefix(f"{run / POLICY}: ").rstrip(".")
        raise CaseError(str(run / POLICY), "", None, message) from None
    except (ValueError, ModuleNotFoundError) as error:
        if isinstance(error, CaseError):
            raise
        raise CaseError("snapo export", "", None, str(error).rstrip(".")) from None
    except OSError as error:
        message = f"the file cannot be written ({error.strerror})"
        raise CaseError(str(run), "", None, message) from None


def _setup(run: Path, record: dict, simulator: tuple[str, str] | None) -> Setup:
    """The problem of a run, made from the run's copy of the case."""
    domain = domain_of_run(run, record, simulator)
    case = domain.read(*case_of_run(run, record))
    study = domain.study(case, options_of_run(domain, case, record, "auto"))
    if study.setup is None:
        raise no_policy(run, record)
    return study.setup()


def decisions_on_paths(problem: Problem, policy: Policy) -> tuple[list[str], list[tuple]]:
    """Names and rows of a table with path, step, numbers of the state, observation and decision.

    The rows are all steps of the first paths of the evaluation. If the policy has a memory, the
    last columns of the observation are the memory, and those of the decision are the next memory.
    """
    size, problem = problem.action.size, remembering(problem, policy)
    simulator, source = problem.simulator, problem.sources.evaluation
    paths = np.arange(source.available(-(-ROWS // simulator.horizon)))
    draws = source.draws(paths, simulator)
    rollout = Xla("float64").bind(problem).values(policy, draws, Exact(), record=("state",))
    steps = simulator.horizon
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[:steps], rollout.record["state"])
    with jax.enable_x64(True):
        constants, by_step = jax.tree.map(
            jnp.asarray, (problem.schedule.constants, problem.schedule.steps)
        )

        @compiled_sooner
        def observe(constants, by_step, states):
            of_paths = jax.vmap(simulator.observe, (None, None, 0))
            return jax.vmap(of_paths, (None, 0, 0))(constants, by_step, states)

        observed = np.asarray(observe(constants, by_step, states))
        observed = observed.reshape(-1, observed.shape[-1])
        actions = np.asarray(decided(policy, None, jnp.asarray(observed, jnp.float64)))
    own = states["own"] if remembered(policy) else states
    names = [f"action {i}" for i in range(size)]
    names += [f"next memory {i}" for i in range(actions.shape[1] - size)]
    columns = {
        "path": np.tile(paths, steps),
        "step": np.repeat(np.arange(steps), len(paths)),
        **{f"state {name}": values.ravel() for name, values in named_series(own, "state").items()},
        **{f"observation {i}": values for i, values in enumerate(observed.T)},
        **dict(zip(names, actions.T)),
    }
    return list(columns), list(zip(*(values.tolist() for values in columns.values())))
