"""Finds the mistakes in a simulator before it is trained.

`check` calls the examinations in order; `findings` has their results. Without a rollout: `shapes`,
`slices`, `traces` and `indices`. On the paths of `rollout`: `jumps`, and `indices` that depend on
the path, in programs that `watch` records; `effects`; `bumps` of inputs. `methods` calls the
simulator.
"""
