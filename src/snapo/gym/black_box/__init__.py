"""Environments that are not differentiable: a model is fitted, and the policy is trained in the
model.

`learn.learn` is the public function and `rounds` its loop. `real` counts and stores every step of
the environment, `ensemble` is fitted to these steps, and the policy is trained in `model`.
"""
