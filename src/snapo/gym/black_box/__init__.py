"""Environments that are not differentiable: a model is fitted, and the policy trained in it."""
