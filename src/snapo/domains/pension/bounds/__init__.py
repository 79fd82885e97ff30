"""A bound from above for a fund: no policy's expected utility of the funding ratio is higher.

`relaxation.FundRelaxation` is the inner problem of `snapo.bound`: the best outcome of a path at a
deflator's prices, within the rights and payments that no decision can undercut or exceed.
"""
