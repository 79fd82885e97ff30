"""The machine's processor and cores, which JAX must hear of before its first computation."""

import os
from contextlib import suppress


def use_every_core() -> None:
    """XLA runs one device per core, where JAX has not computed yet.

    Beside a GPU everything but an engine's rollouts runs on the processor all the same: its many
    small programs take longer to compile for a GPU than to run.
    """
    import jax

    jax.config.update("jax_default_device", "cpu")
    with suppress(RuntimeError):  # it has computed already: then it keeps the devices it has
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
