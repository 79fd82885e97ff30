"""Environments that are not differentiable: a model is fitted, and the policy trained in it.

`learn.learn` is the public function, `rounds` its loop: `real` counts every step of the
environment, `ensemble` is fitted to them, and the policy is trained in `model`.
"""
