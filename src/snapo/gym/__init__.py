"""Gymnasium: turns a simulator into an environment, and plays a policy in any environment.

    environment = snapo.gym.Environment(problem)          # or VectorEnvironment(problem, 1024)
    played = snapo.gym.play(snapo.gym.Agent(policy), "Pendulum-v1", starts=2000)

`snapo.learn` finds a policy for an environment that cannot be differentiated (`black_box`).

Gymnasium comes with `pip install snapo[gym]`.
"""

from typing import Any

HOMES = {
    "Agent": "agent",
    "Environment": "environments",
    "Played": "environments",
    "VectorEnvironment": "environments",
    "play": "environments",
}


def __getattr__(name: str) -> Any:
    if name not in HOMES:
        raise AttributeError(f"module 'snapo.gym' has no attribute {name!r}")
    from importlib import import_module

    result = getattr(import_module(f"{__name__}.{HOMES[name]}"), name)
    globals()[name] = result  # the function `play`, not the module of its name
    return result


def __dir__() -> list[str]:
    return sorted(HOMES)
