"""What every domain's case format shares: one TOML file, plain files beside it, clear errors.

A case is data: nothing in it is executed, and every file that it names lies beside it. The
records here are NumPy and the standard library; pydantic checks the tables at this border.
"""

import datetime
import difflib
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pydantic
from pydantic import Field


class CaseError(ValueError):
    """A case that cannot be read, or a contract that cannot be met.

    **Arguments:**

    - `file`: the file with the mistake, as its owner knows it.
    - `where`: the key ("contract.max_injection"), the line ("line 7") or the date.
    - `value`: what stands there; `None` where something is missing.
    - `allowed`: what would be right, as a clause.
    - `others`: further mistakes found in the same reading.
    """

    def __init__(self, file: str, where: str, value: Any, allowed: str, others=()):
        self.file, self.where, self.value, self.allowed = file, where, value, allowed
        self.others: tuple[CaseError, ...] = tuple(others)
        super().__init__(file, where, value, allowed)

    def __str__(self) -> str:
        place = f"{self.file}, {self.where}" if self.where else self.file
        got = "" if self.value is None else f" got {show(self.value)};"
        return "\n".join([f"{place}:{got} {self.allowed}.", *map(str, self.others)])


def show(value: Any) -> str:
    """A value as its owner wrote it: dates in ISO form, text in quotes, long lists cut short."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float | np.floating):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {show(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        value = Unquoted("[" + ", ".join(map(show, value)) + "]")
    text = value if isinstance(value, Unquoted) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


class Unquoted(str):
    """A description in place of a value ("an unknown key"), shown without quotation marks."""


@dataclass(frozen=True, eq=False)
class Given:
    """Numbers that the owner of the case gave, and where each of them is used.

    The per-day array is always `values[index]`: a simulator makes `values` an `Input` with this
    name, unit and labels, and takes `[index]` inside `prepare`, so that the sensitivity to every
    number that was given comes out under its own label.

    **Attributes:**

    - `name`: the key in the case, "max_inventory".
    - `values`: [n] float64, in `unit`.
    - `labels`: [n] a date, a month, a ratchet row …; `("",)` for a single plain number.
    - `unit`: "MWh/day", "EUR/MWh", "1/year", or "1" for a pure number.
    - `index`: integers of any shape into `values`; unused numbers are not referred to.
    """

    name: str
    values: np.ndarray
    labels: tuple[str, ...]
    unit: str
    index: np.ndarray

    def __post_init__(self):
        if len(self.labels) != len(self.values):
            raise ValueError(f"{self.name}: {len(self.values)} values, {len(self.labels)} labels.")

    def used(self) -> np.ndarray:
        """`values[index]`, the numbers where they are used."""
        return self.values[self.index]


@dataclass(frozen=True)
class Section:
    """A table of a case while it is read: names the place of a mistake, collects remarks."""

    file: Path
    name: str
    notes: list[str]

    def error(self, key: str, value: Any, allowed: str) -> CaseError:
        """A mistake in what stands under `key`."""
        return CaseError(str(self.file), f"{self.name}.{key}", value, allowed)


class Table(pydantic.BaseModel):
    """A strict TOML table: no unknown keys, no conversions, no NaN or infinite numbers."""

    model_config = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )


Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]


class Training(Table):
    """`[training]`: how the policy is trained; fields and defaults are those of `snapo.train`."""

    steps: Annotated[int, Field(ge=0)] = Field(240, description="a whole number, 0 or more")
    paths: Annotated[int, Field(ge=2)] = Field(512, description="a whole number, 2 or more")
    learning_rate: Positive = Field(0.01, description="a number above 0")
    warmup: Annotated[int, Field(ge=0)] = Field(20, description="a number of steps, 0 or more")
    temperature_start: Positive = Field(0.02, description="a number above 0")
    temperature_end: Positive = Field(0.005, description="a number above 0")
    average: Annotated[float, Field(gt=0, le=1)] = Field(
        0.05, description="a number above 0, at most 1"
    )
    validation_paths: Count = Field(4096, description="a whole number, 1 or more")
    validation_every: Count = Field(50, description="a number of steps, 1 or more")
    patience: Count | None = Field(None, description="a number of validations, 1 or more")
    window: Count | None = Field(None, description="a number of days, 1 or more")
    clip: Positive | None = Field(None, description="a number above 0")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(0, description="a whole number, 0 or more")


class Evaluation(Table):
    """`[evaluation]`: the fresh scenarios on which the exact value is measured."""

    paths: Annotated[int, Field(ge=64)] = Field(65536, description="a whole number, 64 or more")
    sensitivity_paths: Annotated[int, Field(ge=64)] = Field(
        16384, description="a whole number, 64 or more"
    )
    scenarios: Literal["pseudo-random", "sobol"] = Field(
        "pseudo-random", description='"pseudo-random" or "sobol"'
    )


class Objective(Table):
    """`[objective]`: what the policy maximises; `kind` says which of the other keys apply.

    `level`: "cvar" is the mean of the worst 1 - level of the paths. `risk_aversion`: of
    "mean-variance" and "entropic" in 1/currency, of "crra" a pure number. `wealth`: currency,
    added to each path's total under "crra". `target`: currency, what "target" stays close to.
    """

    kind: Literal["mean", "cvar", "mean-variance", "entropic", "crra", "target"] = Field(
        "mean", description='"mean", "cvar", "mean-variance", "entropic", "crra" or "target"'
    )
    level: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="a number between 0 and 1"
    )
    risk_aversion: Positive | None = Field(None, description="a number above 0")
    wealth: Positive | None = Field(None, description="a number above 0")
    target: float | None = Field(None, description="a number")


OBJECTIVE_KEYS = {
    "mean": (),
    "cvar": ("level",),
    "mean-variance": ("risk_aversion",),
    "entropic": ("risk_aversion",),
    "crra": ("risk_aversion", "wealth"),
    "target": ("target",),
}

AnyTable = TypeVar("AnyTable", bound=Table)


def load(path: Path) -> tuple[Path, dict[str, Any]]:
    """Reads the case at `path`, a TOML file or a folder with `case.toml`; returns file and data."""
    file = path / "case.toml" if path.is_dir() else path
    if not file.is_file():
        what = "a case is a TOML file, or a folder with case.toml in it; there is none here"
        raise CaseError(str(path), "", None, what)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaseError(str(file), "", None, not_utf8(error)) from None
    except OSError as error:
        raise CaseError(str(file), "", None, f"cannot be read ({error.strerror})") from None
    if not text.strip():
        raise CaseError(str(file), "", None, "the file is empty; `snapo new` writes a case")
    try:
        return file, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _not_toml(file, text, str(error)) from None


def _not_toml(file: Path, text: str, message: str) -> CaseError:
    """The parser's complaint, with the line that it is about."""
    found = re.search(r"line (\d+)", message)
    if found is None:
        return CaseError(str(file), "", None, f"this is not valid TOML: {message}")
    number = int(found[1])
    got = text.splitlines()[number - 1].strip()
    what = f"this is not valid TOML ({message.partition(' (at ')[0]})"
    return CaseError(str(file), f"line {number}", got, what)


def not_utf8(error: UnicodeDecodeError) -> str:
    """The sentence about a text file in another encoding, with the line and the byte."""
    raw = error.object
    line = raw.count(b"\n", 0, error.start) + 1
    return f"byte 0x{raw[error.start]:02x} on line {line} is not UTF-8; save the file as UTF-8"


def parse(table: type[AnyTable], data: Any, file: str, name: str) -> AnyTable:
    """Checks the TOML table `data`, called `name` in messages; collects all of its mistakes."""
    if not isinstance(data, Mapping):
        raise CaseError(file, name, data, f"this must be a table, [{name}]")
    try:
        return table.model_validate(dict(data))
    except pydantic.ValidationError as error:
        found, meant = {}, set()
        for item in error.errors():
            key = str(item["loc"][0])
            # Of a union's several complaints about one key, the first stands for all.
            found.setdefault(key, _explain(table, data, file, name, item))
            if item["type"] == "extra_forbidden":
                meant.update(difflib.get_close_matches(key, table.model_fields, n=1))
        # A key that is missing because it is misspelt is one mistake, not two.
        found = {key: each for key, each in found.items() if key in data or key not in meant}
    first, *rest = found.values()
    raise CaseError(first.file, first.where, first.value, first.allowed, rest)


def _explain(table, data, file, name, item) -> CaseError:
    key = str(item["loc"][0])
    where = f"{name}.{key}" if name else key
    if item["type"] == "extra_forbidden":
        what = f"there is no such key; {nearest(key, table.model_fields)}"
        return CaseError(file, where, data[key], what)
    allowed = table.model_fields[key].description or item["msg"]
    if item["type"] == "missing":
        return CaseError(file, where, None, f"this key is missing; it is {allowed}")
    value = data[key]
    if isinstance(value, str) and table.model_fields[key].annotation is datetime.date:
        allowed += ", without quotation marks"
    if isinstance(value, float) and not math.isfinite(value):
        allowed += ", and finite"
    return CaseError(file, where, value, f"allowed is {allowed}")


def nearest(key: str, known) -> str:
    """Suggests the known key nearest to an unknown one, or lists them all."""
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if close:
        return f"the nearest known key is {close[0]}"
    return f"the known keys are {', '.join(known)}"


def read_objective(
    data: Mapping, file: str, name: str = "objective", optional: tuple[str, ...] = ()
) -> Objective:
    """Reads the table `name`, and checks that the keys are those of its kind.

    Keys in `optional` may be left out where other domains need them.
    """
    objective = parse(Objective, data, file, name)
    kind = objective.kind
    for key in OBJECTIVE_KEYS[kind]:
        if key not in data and key not in optional:
            raise CaseError(file, f"{name}.{key}", None, f'kind "{kind}" needs this key')
    for key in data:
        if key not in ("kind", *OBJECTIVE_KEYS[kind]):
            owners = [f'"{each}"' for each, keys in OBJECTIVE_KEYS.items() if key in keys]
            what = f'kind "{kind}" has no such key; it belongs to {", ".join(owners)}'
            raise CaseError(file, f"{name}.{key}", data[key], what)
    return objective


def read_training(data: Mapping, file: str) -> Training:
    """Reads `[training]`; the temperature may only fall."""
    training = parse(Training, data, file, "training")
    if training.temperature_end > training.temperature_start:
        where, value = "training.temperature_end", training.temperature_end
        what = f"allowed is at most temperature_start, {training.temperature_start:g}"
        raise CaseError(file, where, value, what)
    return training


def read_evaluation(data: Mapping, file: str) -> Evaluation:
    """Reads `[evaluation]`."""
    return parse(Evaluation, data, file, "evaluation")
