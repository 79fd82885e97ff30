"""Derivatives of quality attributes, how they split into paths, and their checks.

`jacobian.matrix` computes them by adjoint or forward mode, `attribution.split` by path through the
units; `certify`, `convergence` and `grids` check them.
"""
