"""Finds the mistakes in a simulator before it is trained.

`check` calls the examinations in order, and `findings` contains their results. `shapes`, `traces`
and `indices` need no rollout. `jumps`, `effects`, `bumps` of inputs and those `indices` that depend
on the path are examined on the paths of `rollout`, in programs that `watch` records. `methods`
calls the simulator.
"""
