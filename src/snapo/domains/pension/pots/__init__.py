"""Funds of personal pots under Dutch law: the return is shared among cohorts and a reserve.

`simulator.PotSimulator` replaces the simulator of a fund of promised rights, in the same market.
"""
