"""Policies for the weights of a fund: the network and classical policies.

All policies decide within `allocation.AllocationLimits`: weights within bounds and groups, and
swaps that are backed by collateral.
"""
