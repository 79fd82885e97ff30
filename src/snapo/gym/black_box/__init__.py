"""Environments that are not differentiable: a model is learnt of them, and the policy inside it."""
