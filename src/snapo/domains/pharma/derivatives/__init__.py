"""Derivatives of quality attributes, how they split into paths, and their checks.

`jacobian.matrix` computes them by adjoint or forward mode, `local` for every single unit, from
which `chapters.attribution` composes paths. `certify` and `convergence` check them.
"""
