"""Upper bounds: fitted value iteration for Gaussian price factors, and the best flows of a store at
known prices.

`relaxation.StoreRelaxation` is the inner problem of `snapo.bound`. The penalty is made from the
fitted value of `value_iteration`, as is the value table of the policy.
"""
