"""Settings of Stable-Baselines3 by problem and algorithm, with their source.

For Pendulum they are those of RL Zoo (DLR-RM/rl-baselines3-zoo, hyperparams/ppo.yml, sac.yml and
td3.yml, where those of PPO are marked as tuned). RL Zoo has none for the other four problems. For
these PPO has the defaults of the library, with more parallel paths and larger batches, and with
rewards divided by their running deviation ("normalize" in RL Zoo). SAC and TD3 have the defaults of
the library with two layers of 64 units (with 256, the default, a gradient step takes four times as
long), on eight parallel paths. They make one gradient step for every fourth simulated step, since
these problems are noisy and their simulators cheap.
"""

from typing import Any, NamedTuple


class Settings(NamedTuple):
    """`steps` simulated steps on `paths` parallel paths; the keywords of the algorithm; the
    standard deviation of TD3's exploration; whether rewards are divided by their running
    deviation."""

    steps: int
    paths: int
    keywords: dict[str, Any]
    exploration: float = 0.0
    normalise: bool = False


ZOO = {
    "ppo": Settings(100_000, 4, {
        "n_steps": 1024, "gae_lambda": 0.95, "gamma": 0.9, "n_epochs": 10, "ent_coef": 0.0,
        "learning_rate": 1e-3, "clip_range": 0.2, "use_sde": True, "sde_sample_freq": 4,
    }),
    "sac": Settings(20_000, 1, {"learning_rate": 1e-3}),
    "td3": Settings(20_000, 1, {
        "gamma": 0.98, "buffer_size": 200_000, "learning_starts": 10_000, "gradient_steps": -1,
        "train_freq": (1, "episode"), "learning_rate": 1e-3,
        "policy_kwargs": {"net_arch": [400, 300]},
    }, exploration=0.1),
}  # fmt: skip

OFF_POLICY = {
    "train_freq": 1, "gradient_steps": 2, "learning_starts": 2000,
    "policy_kwargs": {"net_arch": [64, 64]},
}  # fmt: skip
OWN = {
    "ppo": Settings(1_000_000, 16, {"n_steps": 512, "batch_size": 256}, normalise=True),
    "sac": Settings(100_000, 8, OFF_POLICY),
    "td3": Settings(100_000, 8, OFF_POLICY, exploration=0.1),
}


def settings(problem: str, algorithm: str) -> Settings:
    """The settings of "ppo", "sac" or "td3" for a problem."""
    return (ZOO if problem == "pendulum" else OWN)[algorithm]
