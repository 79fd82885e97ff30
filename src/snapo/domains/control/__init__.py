"""Control: a plant steered step by step towards a target, at minimum cost."""

from snapo.study.kind import Kind

SIZES = (
    "pendulum", "mountain-car", "cart-pole", "double-integrator", "linear-quadratic", "measured",
    "two-tanks", "quadrotor",
)  # fmt: skip

DOMAIN = Kind(
    "control",
    "a plant to control: pendulum, cart and pole, tanks, a linear plant …",
    __name__,
    {size: f"template/{size}" for size in SIZES},
    reader="read:read_case",
    summary="summary:lines",
    tables="read:formats",
)
