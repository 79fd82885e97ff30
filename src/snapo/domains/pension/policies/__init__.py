"""Policies for the weights of a fund: the network, classical ones, and closed forms.

All policies decide within `allocation.AllocationLimits`: weights within bounds and groups, and
swaps that are backed by collateral.
"""
