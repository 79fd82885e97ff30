"""Fitted value iteration for Gaussian price factors, and the store with known prices: the bound.

`relaxation.StoreRelaxation` is the inner problem of `snapo.bound`. Its penalty comes from the fit
of `value_iteration`, from which the value table of the policy is made too.
"""
