"""snapo beside reinforcement learning: the same simulator, observations, starts and machine.

    python -m benchmarks.reinforcement_learning PROBLEM --algorithm ppo sac td3 snapo --seeds 0 1

`tasks` are the problems, `told` their words; `yardstick` values every rule on the same paths of
the exact simulator, `clock` counts time without that. `settings` are those of Stable-Baselines3,
`learners` trains by it, `ours` by snapo; `regression` is least-squares Monte Carlo. `table`
compares the curves.
Stable-Baselines3 and torch come with `pip install snapo[baselines]`.
"""
