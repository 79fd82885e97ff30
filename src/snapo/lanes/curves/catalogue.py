"""All curves by the name of their primitive, as objects that `Code.apply` takes."""

from collections.abc import Callable

from ..emit.code import Code, Curve
from ..emit.ref import Ref
from . import angles, error, exponentials, logarithms, powers
from .arithmetic import Arithmetic


def _curve(name: str, arguments: int, function: Callable[..., Ref]) -> Curve:
    """A curve from a function of an `Arithmetic` and its arguments."""

    def write(code: Code, *inputs: Ref) -> Ref:
        return function(Arithmetic(code, inputs[0].dtype, inputs[0].lanes), *inputs)

    return Curve(name, arguments, write)


CURVES: dict[str, Curve] = {
    curve.name: curve
    for curve in (
        _curve("exp", 1, exponentials.exp),
        _curve("expm1", 1, exponentials.expm1),
        _curve("log", 1, logarithms.log),
        _curve("log1p", 1, logarithms.log1p),
        _curve("tanh", 1, exponentials.tanh),
        _curve("logistic", 1, exponentials.logistic),
        _curve("erf", 1, error.erf),
        _curve("pow", 2, powers.power),
        _curve("sin", 1, angles.sin),
        _curve("cos", 1, angles.cos),
        _curve("atan2", 2, angles.atan2),
    )
}
