"""`--simulator module:Class`: a simulator of the user's own, named on the command line only.

The class offers `from_case(case, folder) -> (simulator, inputs, objective)`, a class method that
reads the case's TOML tables and any files in its folder. `[training]` and `[evaluation]` are read
here as for every domain.
"""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError, Unquoted
from snapo.case.settings import read_evaluation, read_training
from snapo.case.table import load


def load_simulator(module: str, name: str) -> Any:
    """The class `name` of `module`, looked for in the working directory first."""
    place = f"{module}:{name}"
    sys.path.insert(0, str(Path.cwd()))
    try:
        found = getattr(import_module(module), name, None)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0] and error.name != module:
            raise
        got = Unquoted(place)
        raise CaseError("--simulator", "", got, f"there is no module {error.name}") from None
    finally:
        sys.path.remove(str(Path.cwd()))
    if found is None:
        what = f"the module {module} has no {name}"
        raise CaseError("--simulator", "", Unquoted(place), what)
    if not callable(getattr(found, "from_case", None)):
        what = "the class needs a class method from_case(case, folder)"
        raise CaseError("--simulator", "", Unquoted(place), what)
    return found


def read_own(place: tuple[str, str], path: Path) -> tuple[Path, dict[str, Any]]:
    """The case file at `path`, and what `snapo.solve` takes for the simulator at `place`."""
    own = load_simulator(*place)
    file, data = load(path)
    training = read_training(data.get("training", {}), str(file))
    evaluation = read_evaluation(data.get("evaluation", {}), str(file))
    simulator, inputs, objective = own.from_case(data, file.parent)
    return file, {
        "simulator": simulator,
        "inputs": inputs,
        "objective": objective,
        "training": training,
        "evaluation": evaluation,
    }
