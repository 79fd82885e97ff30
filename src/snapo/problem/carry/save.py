"""`policy.save(file)` and `snapo.load_policy(file)`: a policy in a file that describes itself."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..smooth import Exact
from .arrays import read_arrays, write_arrays
from .latest import followed


def described(tree: Any) -> dict[str, str]:
    """{position: text} of a policy or a tree of policies. A text is the name of a class or of a
    function, or a setting that is a number, a text, True, False or None.

    Positions are like "policy.activation". Nothing depends on the process: functions and classes
    have only their names. Arrays are left out.
    """
    return dict(_lines(tree, ""))


def difference(stored: Mapping[str, str], now: Mapping[str, str]) -> str:
    """The first difference as a clause, "its activation is tanh, but must be silu"; or "".

    A position that only one of the two has is ignored: another version may have added it.
    """
    for position, text in now.items():
        if stored.get(position, text) != text:
            return f"its {position} is {stored[position]}, but must be {text}"
    return ""


def _lines(value: Any, position: str):
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield f"{position} kind".strip(), type(value).__name__
        for field in dataclasses.fields(value):
            yield from _lines(
                getattr(value, field.name, None), f"{position}.{field.name}".strip(".")
            )
    elif isinstance(value, Mapping):
        for key, field in value.items():
            yield from _lines(field, f"{position}.{key}".strip("."))
    elif isinstance(value, list | tuple):
        for index, field in enumerate(value):
            yield from _lines(field, f"{position}[{index}]")
    elif isinstance(value, jax.Array | np.ndarray):
        return  # shapes are compared where the numbers are read
    elif value is None or isinstance(value, bool | int | float | str):
        yield position, repr(value)
    elif callable(value):
        yield position, _function_name(value)
    else:
        yield f"{position} kind".strip(), type(value).__name__


def _function_name(function: Any) -> str:
    """A function's name, with the settings of a partial one."""
    if isinstance(function, partial):
        values = [*map(repr, function.args), *(f"{k}={v!r}" for k, v in function.keywords.items())]
        plain = [item for item in values if " at 0x" not in item]
        return f"{_function_name(function.func)}({', '.join(plain)})"
    return str(getattr(function, "__name__", type(function).__name__))


# {class: its module}. Domains' modules are loaded where a file names one of theirs.
KINDS = {
    **dict.fromkeys(("MLP", "Residual", "Network"), "snapo.problem.policy"),
    **dict.fromkeys(
        ("Constant", "Linear", "BaseStock", "Threshold"), "snapo.problem.policies.rules"
    ),
    **dict.fromkeys(
        ("Box", "Choice", "Product", "Simplex", "Stop", "Integers"), "snapo.problem.actions"
    ),
    "Frozen": "snapo.problem.inputs",
    "Stages": "snapo.problem.policies.composed",
    **dict.fromkeys(("GRU", "LastObservations"), "snapo.problem.policies.memory"),
    "StoragePolicy": "snapo.domains.gas_storage.policy.network",
    "UnitValuePolicy": "snapo.domains.energy.core.policy",
    "IntradayPolicy": "snapo.domains.energy.core.intraday",
    "PensionPolicy": "snapo.domains.pension.policies.allocation",
    "AllocationLimits": "snapo.domains.pension.policies.allocation",
    "Cover": "snapo.domains.pension.policies.allocation",
    "Feedback": "snapo.domains.pharma.control.policy",
    "OrderUpTo": "snapo.domains.inventory.policy.order_up_to",
    "Classical": "snapo.domains.inventory.policy.rules",
    "EchelonRule": "snapo.domains.inventory.network.policy",
}

_SIMPLE = (
    jax.nn.silu, jax.nn.tanh, jax.nn.relu, jax.nn.gelu, jax.nn.elu, jax.nn.selu, jax.nn.softplus,
    jax.nn.sigmoid, jax.nn.leaky_relu, jax.nn.celu, jax.nn.relu6, jax.nn.soft_sign, jnp.sin,
)  # fmt: skip


@cache
def functions() -> dict[str, Callable]:
    """{name: function}: the activations that a file may name."""
    return {item.__name__: item for item in _SIMPLE}


def name_of(function: Callable) -> str | None:
    """The registered name of a function; None for any other function."""
    available = functions()
    return next((name for name, item in available.items() if item is function), None) or (
        "tanh" if function is jnp.tanh else None
    )


@cache
def class_of(name: str) -> type:
    """The class of a name in `KINDS`."""
    return getattr(import_module(KINDS[name]), name)


DEEPEST = 20  # levels of policies in policies


class NotKnown(ValueError):
    """A part of a policy that no file can describe: its place and kind."""


def encoded(value: Any, arrays: list[np.ndarray], position: str = "policy") -> Any:
    """The JSON form of a policy; its arrays are appended to `arrays`.

    **Raises:** `NotKnown` at a class or function that is not in the registry.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, np.generic):
        return encoded(value.item(), arrays, position)
    if isinstance(value, jax.Array | np.ndarray):
        arrays.append(np.asarray(value))
        return {"array": len(arrays) - 1, "numpy": not isinstance(value, jax.Array)}
    if type(value) in (tuple, list):
        items = [encoded(item, arrays, f"{position}[{i}]") for i, item in enumerate(value)]
        return {type(value).__name__: items}
    if isinstance(value, eqx.Module) and not isinstance(value, type):
        name = type(value).__name__
        if name not in KINDS or type(value) is not class_of(name):
            _unknown(value, position)
        metadata = {
            field.name: encoded(getattr(value, field.name), arrays, f"{position}.{field.name}")
            for field in dataclasses.fields(value)
        }
        return {"kind": name, "fields": metadata}
    if callable(value) and (name := name_of(value)):
        return {"function": name}
    return _unknown(value, position)


def _unknown(value: Any, position: str) -> Any:
    name = getattr(value, "__name__", type(value).__name__)
    raise NotKnown(
        f"its {position} is {name}" if position != "policy" else f"it is of class {name}"
    )


def decoded(metadata: Any, arrays: Sequence[np.ndarray], depth: int = 0) -> Any:
    """The inverse of `encoded`.

    **Raises:** `ValueError`, `KeyError` or `TypeError` for anything that `encoded` does not write.
    """
    if depth > 3 * DEEPEST:
        raise ValueError("it is nested too deeply")
    if metadata is None or isinstance(metadata, bool | int | str | float):
        return metadata
    match metadata:
        case {"array": int(index), "numpy": bool(plain)} if 0 <= index < len(arrays):
            return arrays[index] if plain else jnp.asarray(arrays[index])
        case {"float": "inf" | "-inf" | "nan" as text}:
            return float(text)
        case {"tuple": list(items)}:
            return tuple(decoded(item, arrays, depth + 1) for item in items)
        case {"list": list(items)}:
            return [decoded(entry, arrays, depth + 1) for entry in items]
        case {"function": str(name)} if name in functions():
            return functions()[name]
        case {"kind": str(name), "fields": dict(fields)} if name in KINDS:
            return _made(class_of(name), fields, arrays, depth)
    raise ValueError(f"it names {str(metadata)[:60]!r}, which this version does not know")


def _made(kind: type, fields: dict[str, Any], arrays: Sequence[np.ndarray], depth: int) -> Any:
    """An object with these fields; its constructor is not called."""
    available = {item.name: item for item in dataclasses.fields(kind)}
    if other := set(fields) - set(available):
        raise ValueError(f"a {kind.__name__} has no {sorted(other)[0]!r} in this version")
    made = object.__new__(kind)
    for name, field in available.items():
        if name in fields:
            value = decoded(fields[name], arrays, depth + 1)
        elif field.default is not dataclasses.MISSING:
            value = field.default  # a field that an older version did not have
        else:
            raise ValueError(f"a {kind.__name__} has {name!r} in this version, but not in the file")
        object.__setattr__(made, name, value)
    return made


class _Named(NamedTuple):
    """A function of `functions`."""

    name: str


def reduced(module: eqx.Module) -> tuple:
    """The result of `__reduce__` for a module with functions in its fields."""
    held = {field.name: getattr(module, field.name) for field in fields(module)}  # pyright: ignore
    return _unpacked, (type(module), {name: _packed(value) for name, value in held.items()})


def _packed(value: Any) -> Any:
    name = name_of(value) if callable(value) else None
    return value if name is None else _Named(name)


def _unpacked(kind: type, held: dict[str, Any]) -> Any:
    made = object.__new__(kind)
    for name, value in held.items():
        values = functions()[value.name] if isinstance(value, _Named) else value
        object.__setattr__(made, name, values)
    return made


FORMAT = 1
AnyPolicy = TypeVar("AnyPolicy", bound=eqx.Module)
MISTAKES = (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError)


class PolicyFileError(ValueError):
    """A policy that cannot be written to a file, or a file without a valid policy."""


class StoredPolicy(NamedTuple):
    """The content of a policy's file.

    - `policy`: None if its class is user code, which a file does not contain.
    - `described`: {position: text} of its kinds, sizes and functions; `leaves`: its arrays.
    - `features`: the length of its observation, None if that is unknown.
    """

    policy: Any
    described: Mapping[str, str]
    leaves: list[Any]
    features: int | None


def save(policy: eqx.Module, file: Path | str, features: int | None, code: bool = False) -> None:
    """Writes a policy that observes this number of features: its kinds, sizes, activations and
    weights.

    With `code`, the arrays of a policy with user code are written, for a reader who has the code.

    **Raises:** `PolicyFileError` for a policy with user code, unless `code`.
    """
    arrays: list[Any] = []
    try:
        metadata = encoded(policy, arrays)
    except NotKnown as error:
        if not code:
            raise PolicyFileError(
                f"policy.save: {error}, which is user code, and a file contains no code. Use "
                "solution.save(folder) and Solution.load(folder, like=policy) with a policy made "
                "by your code instead, or export it with snapo.to_onnx, which takes any policy."
            ) from None
        metadata, arrays = None, leaves_of(policy)
    header = {"snapo policy": FORMAT, "features": features, "policy": metadata}
    header["described"] = described({"policy": policy})
    write_arrays(Path(file), {f"leaf_{i}": array for i, array in enumerate(arrays)}, header)


def leaves_of(tree: Any) -> list[np.ndarray]:
    """The arrays of a policy or of a tree of policies."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(tree, eqx.is_array))]


def stored(file: Path | str, base: type[eqx.Module]) -> StoredPolicy:
    """The content of a file that `save` wrote; nothing is executed.

    **Raises:** `PolicyFileError` if the file is missing or damaged, contains something else, or
    weights whose sizes do not fit each other.
    """
    try:
        arrays, header = read_arrays(followed(Path(file)))
    except ValueError as error:
        raise PolicyFileError(str(error)) from None
    if not isinstance(header, dict) or "snapo policy" not in header:
        raise PolicyFileError(f"{file}: this file has no policy written by policy.save.")
    if header["snapo policy"] != FORMAT:
        message = f"is written in format {header['snapo policy']}, but this version reads {FORMAT}"
        raise PolicyFileError(f"{file}: it {message}.")
    try:
        features = header["features"]
        if header["policy"] is None:
            text = {str(name): str(word) for name, word in header["described"].items()}
            return StoredPolicy(None, text, list(arrays.values()), features)
        policy = decoded(header["policy"], list(arrays.values()))
        if not isinstance(policy, base):
            raise ValueError("it holds no policy")
        if features is not None:
            seen = features + getattr(policy, "memory", 0)
            observation = jax.ShapeDtypeStruct((seen,), jnp.float32)
            jax.eval_shape(policy, observation, Exact())  # pyright: ignore[reportArgumentType]
        return StoredPolicy(policy, described({"policy": policy}), leaves_of(policy), features)
    except MISTAKES as error:
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise PolicyFileError(f"{file}: this is not a policy of this version ({text}).") from None


def load(file: Path | str, base: type[AnyPolicy], like: AnyPolicy | None = None) -> AnyPolicy:
    """The policy written by `save`, of a subclass of `base`; with `like` it is that policy with
    the numbers of the file.

    **Raises:** `PolicyFileError` as `stored` does; if the file's policy is user code and there
    is no `like`; and if it differs from `like` in shape, activation or any other setting.
    """
    content = stored(file, base)
    if like is not None:
        return filled(file, content.leaves, content.described, like, {"policy": like})
    if content.policy is None:
        raise PolicyFileError(
            f"{file}: the class of this policy is user code: read it with "
            "Solution.load(folder, like=policy) and a policy made by that code."
        )
    return content.policy


def filled(
    file: Path | str, leaves: Sequence[Any], text: Mapping[str, str], like: Any, policies: Any
) -> Any:
    """The tree `like` with these arrays of a file, whose `text` describes the `policies` in it.

    **Raises:** `PolicyFileError` if they are those of another policy.
    """
    moving, fixed = eqx.partition(like, eqx.is_array)
    old, structure = jax.tree.flatten(moving)
    if [leaf.shape for leaf in old] != [leaf.shape for leaf in leaves]:
        raise PolicyFileError(f"{file}: this file contains a policy of another shape.")
    if text and (other := difference(text, described(policies))):
        raise PolicyFileError(f"{file}: this file contains another policy: {other}.")
    # Tables in NumPy keep their precision, which JAX might not have.
    new = [
        np.asarray(leaf, local.dtype)
        if isinstance(local, np.ndarray)
        else jnp.asarray(leaf, local.dtype)
        for leaf, local in zip(leaves, old)
    ]
    return eqx.combine(structure.unflatten(new), fixed)
