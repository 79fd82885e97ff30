"""The cores of the machine, which JAX must hear of before its first computation."""

import os
from contextlib import suppress


def use_every_core() -> None:
    """XLA runs one device per core, where JAX has not computed yet."""
    import jax

    with suppress(RuntimeError):  # it has computed already: then it keeps the devices it has
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
