"""snapo and reinforcement learning, with the same simulator, observations, starts and machine.

    python -m benchmarks.reinforcement_learning PROBLEM --algorithm ppo sac td3 snapo --seeds 0 1

`tasks` has the problems and `told` their descriptions. `yardstick` values every rule on the same
paths of the exact simulator, and `clock` measures the time of training without these valuations.
`settings` has the settings of Stable-Baselines3, with which `learners` trains; `ours` trains with
snapo, and `regression` is least-squares Monte Carlo. `table` compares the curves. `pip install
'snapo[baselines]'` installs Stable-Baselines3 and torch.
"""
