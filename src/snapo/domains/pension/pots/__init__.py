"""Funds of personal pots under the Dutch law: the return is shared among cohorts, with a reserve.

`simulator.PotSimulator` takes the place of that of a fund of promised rights, in the same market.
"""
