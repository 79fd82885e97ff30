"""Records of numbers, in NumPy: a case as it is read, before anything is differentiated.

A `TreeRecord` is a frozen dataclass. If JAX is loaded it is also a tree of JAX, like a module of
Equinox: its fields are branches, except `static` ones, which belong to its structure. A case is
read, checked and described without JAX, in less time than importing it takes.
"""

import dataclasses
from abc import ABCMeta
from collections.abc import Callable
from inspect import get_annotations
from typing import TYPE_CHECKING, Any, dataclass_transform

import numpy as np

RELATIVE_STEP = 1e-5  # of a number's size: the step of its finite difference
NOTHING = 1e-9  # of the largest entry: a smaller one is a zero with round-off
STATIC, CONVERTER = "static", "converter"  # keys of a field's metadata, as those of Equinox
_CLASSES: list[type["TreeRecord"]] = []  # all that are defined
_UNFINISHED: set[int] = set()  # records whose `__init__` has not returned
_REGISTER: list[Callable[[type["TreeRecord"]], None]] = []  # of JAX, once it is loaded

if TYPE_CHECKING:
    from equinox import AbstractClassVar as AbstractClassVar
    from equinox import AbstractVar as AbstractVar
else:

    class AbstractVar:
        """An attribute that a subclass must have: `size: AbstractVar[int]`."""

        def __class_getitem__(cls, of):
            return cls

    class AbstractClassVar(AbstractVar):
        """The same for a class attribute."""


def field(*, static: bool = False, converter: Callable[[Any], Any] | None = None, **more) -> Any:
    """A field of a record: `dataclasses.field` with two further arguments.

    - `static`: whether it is part of the structure, on which compiled code depends.
    - `converter`: a function of the value, whose result is stored.
    """
    return dataclasses.field(metadata={STATIC: static, CONVERTER: converter}, **more)


class RecordType(ABCMeta):
    """Sets fields in `__init__` only; converters and checks come after it."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        record: Any = cls.__new__(cls, *args, **kwargs)
        _UNFINISHED.add(id(record))
        try:
            record.__init__(*args, **kwargs)
            for item in dataclasses.fields(record):
                if (converter := item.metadata.get(CONVERTER)) is not None:
                    setattr(record, item.name, converter(getattr(record, item.name)))
        finally:
            _UNFINISHED.discard(id(record))
        for base in cls.__mro__:
            if (check := vars(base).get("__check_init__")) is not None:
                check(record)
        return record


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
class TreeRecord(metaclass=RecordType):
    """A frozen dataclass that is a tree of JAX once JAX is loaded; compared by its fields.

    A method `__check_init__` of a class refuses values that do not fit together.
    """

    __abstractvars__ = frozenset[str]()  # names of attributes that a subclass must have
    __left_open__ = frozenset[str]()  # those that this class declares itself
    __own_init__ = False  # whether a class has written its `__init__`, and those below have it too

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        annotations = get_annotations(cls)
        cls.__left_open__ = frozenset(x for x, kind in annotations.items() if _is_abstract(kind))
        cls.__annotations__ = {
            x: kind for x, kind in annotations.items() if x not in cls.__left_open__
        }
        left_open: dict[str, bool] = {}
        for base in reversed(cls.__mro__):
            left_open |= dict.fromkeys(get_annotations(base).keys() | vars(base).keys(), False)
            left_open |= dict.fromkeys(getattr(base, "__left_open__", ()), True)
        cls.__abstractvars__ = frozenset(name for name, missing in left_open.items() if missing)
        cls.__own_init__ = "__init__" in vars(cls) or cls.__own_init__
        # Not frozen: the methods of `TreeRecord` refuse changes, and let `__init__` set fields.
        dataclasses.dataclass(eq=False, init=not cls.__own_init__)(cls)
        _CLASSES.append(cls)
        for register in _REGISTER:
            register(cls)

    def __new__(cls, *args: Any, **kwargs: Any):
        if cls.__abstractvars__:
            names = ", ".join(sorted(cls.__abstractvars__))
            raise TypeError(f"Can't instantiate abstract class {cls.__name__} without {names}")
        return super().__new__(cls)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        record: Any = self
        names = [item.name for item in dataclasses.fields(record)]
        return all(_equal(getattr(self, x), getattr(other, x)) for x in names)

    def __hash__(self) -> int:
        return hash(type(self))  # arrays have no hash

    def __setattr__(self, name: str, value: Any) -> None:
        if id(self) not in _UNFINISHED:
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


def _equal(one: Any, other: Any) -> bool:
    """Whether two values of a field are equal; arrays in type, shape and numbers."""
    if one is other:
        return True
    if hasattr(one, "dtype") or hasattr(other, "dtype"):
        kinds = [(np.shape(x), getattr(x, "dtype", None)) for x in (one, other)]
        return kinds[0] == kinds[1] and bool(np.all(one == other))
    if isinstance(one, tuple | list) and type(one) is type(other):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[k], other[k]) for k in one)
    return bool(one == other)


def _is_abstract(kind: Any) -> bool:
    """Whether an annotation is one of the two above, or one of the same name of Equinox."""
    names = "AbstractVar", "AbstractClassVar"
    if isinstance(kind, str):
        return kind.split("[")[0].rpartition(".")[2] in names
    return getattr(getattr(kind, "__origin__", kind), "__name__", "") in names


def register_all(register: Callable[[type[TreeRecord]], None]) -> None:
    """Calls `register` for every class of records, including later ones."""
    _REGISTER.append(register)
    for cls in _CLASSES:
        register(cls)


class Schedule(TreeRecord):
    """The numbers that all paths share, computed once per call by `Simulator.prepare`.

    **Arguments:**

    - `constants`: any tree of arrays that is valid for the whole horizon.
    - `steps`: a tree of arrays with a leading axis of length `horizon`; step t sees `steps[t]`.

    Both are optional.
    """

    constants: Any = field(default_factory=dict)
    steps: Any = field(default_factory=dict)


def _float64(value: Any) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(
            f"Input: the value {value!r} is not a number. Dates, names and switches belong to the "
            "simulator."
        )
    return array.astype(np.float64)


class Input(TreeRecord):
    """One differentiable input: a float64 array of any shape.

    **Arguments:**

    - `value`: numbers, kept as float64 NumPy.
    - `unit`: the unit of the value, such as "EUR/MWh"; a sensitivity is per this unit.
    - `labels`: one per entry, in C order (dates, tenors, species); by default the entries are
      numbered.
    - `bump`: the step of a finite difference that checks the gradient; by default a share of each
      number (see `step`).
    - `judge_bump`: the bump of every number in the test of its derivative, in which the policy
      reacts; by default 1 % of each number. Specify it if the value is smooth only between points
      of a grid of the input.
    - `move`: the amount by which reports and sliders move it, in `unit`; None: a relative move.
    - `display_unit`, `display_factor`: the preferred unit, by default `unit`, and how many of these
      units make one `unit`: a rate of 1/year is 10,000 bp.
    - `group`: the type of risk, such as "price", "volatility" or "contract".
    - `meaning`: a short description.

    A correlation matrix enters as its strict lower triangle.

    >>> curve = snapo.Input([30.0, 31.5], "EUR/MWh", labels=("2025-01", "2025-02"), move=1.0)
    >>> curve.names()
    ('2025-01', '2025-02')
    >>> snapo.Input([[1, 2], [3, 4]]).names()  # numbered in C order
    ('0,0', '0,1', '1,0', '1,1')
    """

    value: np.ndarray = field(converter=_float64)
    unit: str = field(static=True, default="")
    labels: tuple[str, ...] = field(static=True, default=(), converter=lambda x: tuple(map(str, x)))
    bump: float | None = field(static=True, default=None)
    judge_bump: float | None = field(static=True, default=None)
    move: float | None = field(static=True, default=None)
    display_unit: str = field(static=True, default="")
    display_factor: float = field(static=True, default=1.0)
    group: str = field(static=True, default="")
    meaning: str = field(static=True, default="")

    def __check_init__(self):
        if self.labels and len(self.labels) != self.value.size:
            raise ValueError(
                f"Input: there are {len(self.labels)} labels for {self.value.size} numbers; each "
                "number needs one label."
            )
        if not np.all(np.isfinite(self.value)):
            raise ValueError("Input: a value is NaN or infinite; it must be a finite number.")

    def names(self) -> tuple[str, ...]:
        """One label per entry in C order."""
        if self.labels:
            return self.labels
        if self.value.ndim == 0:
            return ("",)
        return tuple(",".join(map(str, index)) for index in np.ndindex(self.value.shape))

    def step(self) -> np.ndarray:
        """The step of a finite difference of every number, in the input's unit, shaped like it.

        It is `bump` if specified, else 1e-5 of the number. If a number is zero, the largest entry
        is used instead; if all are zero, the step is a thousandth of `move`, or 1e-5 without
        `move`.
        """
        if self.bump is not None:
            return np.full(self.value.shape, float(self.bump))
        size = np.abs(self.value)
        largest = np.max(size, initial=0.0)
        if largest == 0:
            # A move is about 1 % of the number.
            minimum = 1e-5 if not self.move else 1e-3 * abs(self.move)
            return np.full(self.value.shape, minimum)
        return RELATIVE_STEP * np.where(size > NOTHING * largest, size, largest)


def is_input(x: Any) -> bool:
    return isinstance(x, Input)
