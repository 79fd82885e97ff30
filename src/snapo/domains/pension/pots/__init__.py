"""Funds of personal pots under the Dutch law: the return is shared among cohorts, with a reserve.

`simulator.PotSimulator` replaces the simulator of a fund of promised rights, in the same market.
"""
