"""A problem: all arguments of `solve` in one object, used by all packages above."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any, Generic, TypeVar

import jax
import numpy as np
from jaxtyping import PyTree

from . import inputs as inputs_
from .actions import Actions
from .code.lost import lost
from .code.version import Version, of_preparation, of_rollout, read_context, reading_once
from .form import form_of
from .noise import base as noise
from .objective import Limit, Objective, as_constraints, as_objective, priced
from .quickly import compiled_sooner
from .scenarios import Sources
from .simulator import Interface, Schedule, Simulator
from .unseen import partly_observed

FORMS = 64  # whose interfaces are remembered
_interfaces: OrderedDict[Hashable, Interface] = OrderedDict()


def prepare(simulator: Simulator, inputs: PyTree) -> Schedule:
    """The schedule in float64 NumPy."""
    with jax.enable_x64(True), read_context(of_preparation(simulator, inputs)):
        part, completed = simulator.prepared_apart()
        schedule = _prepare(part, inputs_.plain(inputs))
        return jax.tree.map(np.asarray, completed(schedule))


def all_versions(simulator: Simulator, inputs: PyTree) -> Hashable:
    """The versions of all of a simulator's code; a unique one if it cannot be run."""
    try:
        schedule = prepare(simulator, inputs)
        versions = of_preparation(simulator, inputs), of_rollout(simulator, None, schedule)
    except Exception:  # who runs it reports why
        return object()
    return None if versions == (None, None) else versions


@compiled_sooner
def _prepare(simulator: Simulator, plain: PyTree):
    return simulator.prepare(plain)


_In = TypeVar("_In")
_Out = TypeVar("_Out")
NONE: Any = object()  # no default


class Converted(Generic[_In, _Out]):
    """A field of a dataclass that is converted when it is set."""

    def __init__(self, convert: Callable[[_In], _Out], default: Any = NONE):
        self.convert, self.default = convert, default

    def __set_name__(self, user: type, name: str) -> None:
        self.name = name

    def __set__(self, instance: Any, values: _In) -> None:
        instance.__dict__[self.name] = self.convert(values)

    def __get__(self, instance: Any, user: type | None = None) -> _Out:
        if instance is not None:
            return instance.__dict__[self.name]
        if self.default is NONE:  # of the class: the default, if there is one
            raise AttributeError(self.name)
        return self.default


KEPT = ("schedule", "interface", "lost", "partly_observed")  # scenarios do not change these


@dataclass(frozen=True, eq=False)
class Problem:
    """A simulator with its inputs, the objective to maximise, and the scenarios.

    The schedule is prepared once, on first use, in float64 NumPy.

    - `simulator`, `inputs`: one path, and a tree of `Input`s.
    - `objective`: the objective of the path totals, which is maximised. The name of an output
      means its mean: "cash" is `Mean("cash")`.
    - `sources`: the scenarios of training, validation and evaluation; the last two have few paths
      if nothing is random (see `EqualPaths`).
    - `constraints`: limits on averages or probabilities: `[Mean("unserved") <= 0.05]`.
    - `rebuild`: returns the same problem, with everything in its simulator that was computed from
      the inputs (a value table, a hedge, scales of features) recomputed; None if nothing was.
    """

    simulator: Simulator
    inputs: PyTree
    objective: Converted[Objective | str, Objective] = Converted(as_objective)
    sources: Sources = field(default_factory=lambda: Sources.of(None))
    constraints: Converted[Sequence[Limit] | Limit, tuple[Limit, ...]] = Converted(
        as_constraints, ()
    )
    rebuild: Callable[["Problem"], "Problem"] | None = field(default=None, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "sources", self.sources.of_equal_paths(not self.is_random))

    @property
    def schedule(self) -> Schedule:
        """The numbers that all paths share."""
        with reading_once():
            version = of_preparation(self.simulator, self.inputs)
            return self._kept("schedule", version, lambda: prepare(self.simulator, self.inputs))

    @property
    def interface(self) -> Interface:
        """The properties to which a policy is fitted."""
        schedule, version = self.schedule, self.version
        with read_context(version):
            return self._kept("interface", version, lambda: self._interface(schedule, version))

    def _interface(self, schedule: Schedule, version: Version) -> Interface:
        """The interface of an earlier problem of the same form, with the present action set:
        tracing an observation takes a tenth of a second."""
        if version is not None or type(self.simulator).interface is not Simulator.interface:
            return self.simulator.interface(schedule)
        key = self.form
        if key not in _interfaces:
            _interfaces[key] = self.simulator.interface(schedule)
            while len(_interfaces) > FORMS:
                _interfaces.popitem(last=False)
        return _interfaces[key]._replace(action=self.action)

    @property
    def form(self) -> Hashable:
        """All that the compiled code for its paths depends on: problems of the same form share
        that code; numbers, labels and units may differ."""
        return form_of((self.simulator, inputs_.unnamed(self.inputs)))

    @property
    def version(self) -> Version:
        """The version of the simulator's code, from the initial state on."""
        return of_rollout(self.simulator, None, self.schedule)

    def _kept(self, name: str, version: Any, make: Callable[[], Any]) -> Any:
        """A result that was made before, as long as the code that makes it reads the same
        objects."""
        available = self.__dict__.get(name)
        if available is None or available[0] != version:
            available = self.__dict__[name] = version, make()
        return available[1]

    @property
    def is_random(self) -> bool:
        """Whether paths differ from one another under the same decisions."""
        return self.simulator.noise_size + self.simulator.initial_noise_size > 0

    @property
    def partly_observed(self) -> tuple[str, ...]:
        """The names of state numbers that matter for decisions but are not observed. It is empty
        if the observation has all information for decisions, as far as tests on paths show
        (`problem.unseen`). A step is compiled if the observation is incomplete.
        """
        if self.simulator.fully_observed:
            return ()
        version = self.version
        with read_context(version):
            return self._kept("partly_observed", version, lambda: partly_observed(self))

    def _repr_html_(self) -> str:
        """The inputs in a notebook: name, meaning, number of entries, the first entry, unit."""
        rows = [
            f"<tr><td style='text-align:left'>{escape(name)}</td>"
            f"<td style='text-align:left'>{escape(item.meaning)}</td>"
            f"<td>{item.value.size}</td><td>{_first(item.value)}</td><td>{escape(item.unit)}</td></tr>"
            for name, item in self.inputs_by_name.items()
        ]
        titles = ("input", "meaning", "numbers", "first", "unit")
        head = "".join(f"<th style='text-align:left'>{title}</th>" for title in titles)
        steps = f"{type(self.simulator).__name__}, {self.simulator.horizon} steps"
        about = escape(f"{steps}, actions {self.action}, objective {self.objective}")
        return f"<p>{about}</p><table><tr>{head}</tr>{''.join(rows)}</table>"

    def priced(self, prices: Sequence[float]) -> "Problem":
        """The problem whose objective includes prices for its limits; the schedule is reused."""
        if not self.constraints:
            return self
        within = priced(self.objective, self.constraints, prices)
        other = replace(self, objective=within, constraints=())
        return other.prepared(self.schedule)

    def prepared(self, schedule: Schedule) -> "Problem":
        """The same problem with a known schedule: the one that its simulator would prepare."""
        other = replace(self)
        version = of_preparation(self.simulator, self.inputs)
        other.__dict__["schedule"] = version, schedule
        return other

    def on(self, sources: Sources) -> "Problem":
        """The same problem on other scenarios; results known so far are reused."""
        other = replace(self, sources=sources)
        other.__dict__.update({name: self.__dict__[name] for name in KEPT if name in self.__dict__})
        return other

    @property
    def features(self) -> int:
        """The number of features that a policy sees."""
        return self.interface.features

    @property
    def action(self) -> Actions:
        """The action set."""
        return self.simulator.action

    @property
    def inputs_by_name(self) -> dict[str, inputs_.Input]:
        """The inputs by name, in the order of sensitivity tables."""
        return {entry.name: entry.input for entry in inputs_.named_inputs(self.inputs)}

    @property
    def in_mean(self) -> tuple[str, ...]:
        """The inputs whose derivative is correct only in the mean of many paths."""
        return in_mean(self.simulator, self.inputs)

    @property
    def lost(self) -> tuple[str, ...]:
        """The inputs that affect the outputs only through rounding or comparisons in a user's code:
        their derivative is 0 on every path, and the derivative of the value is unknown."""
        version = of_preparation(self.simulator, self.inputs), self.version
        if version == (None, None):
            return ()
        names = self._kept("lost", version, lambda: tuple(lost(self.simulator, self.inputs)))
        return tuple(name for name in names if name not in self.in_mean)

    def at(self, values: dict[str, Any]) -> "Problem":
        """The same problem with other values of the named inputs.

        **Raises:** `KeyError` for a name that is not an input.
        """
        if unknown := set(values) - set(self.inputs_by_name):
            raise KeyError(
                f"there is no input {sorted(unknown)}; the inputs are {list(self.inputs_by_name)}."
            )
        return self.with_inputs(
            [values.get(name, inputs.value) for name, inputs in self.inputs_by_name.items()]
        )

    def at_values(self, values: dict[str, Any]) -> "Problem":
        """The problem at other values of the named inputs, with everything that was computed from
        them recomputed; the policy of a solution can be valued there unchanged.

        **Raises:** `KeyError` for a name that is not an input.
        """
        other = self.at(values)
        return other if self.rebuild is None else self.rebuild(other)

    def with_inputs(self, values: list[Any]) -> "Problem":
        """The same problem with other values of all inputs, in the order of `inputs_by_name`."""
        remaining = iter(values)

        def put(leaf):
            if not inputs_.is_input(leaf):
                return leaf
            return replace(leaf, value=np.asarray(next(remaining), np.float64))

        moved = jax.tree.map(put, self.inputs, is_leaf=inputs_.is_input)
        return replace(self, inputs=moved)


def in_mean(simulator: Simulator, inputs: PyTree) -> tuple[str, ...]:
    """The inputs whose derivative is correct only in the mean of many paths: those named by the
    simulator, and the parameters of noises with discrete draws."""
    values = {*simulator.in_mean(), *noise.in_mean(inputs)}
    return tuple(entry.name for entry in inputs_.named_inputs(inputs) if entry.name in values)


def _first(values: np.ndarray) -> str:
    """The first number of an input, and whether there are more."""
    displayed = f"{values.flat[0]:,.6g}" if values.size else ""
    return displayed + (" …" if values.size > 1 else "")
