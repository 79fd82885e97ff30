"""An upper bound for a fund: no policy has a higher expected utility of the funding ratio.

`relaxation.FundRelaxation` is the inner problem of `snapo.bound`: the best outcome of a path at a
deflator's prices. Its rights and payments are the extremes that no decision can undercut or exceed.
"""
