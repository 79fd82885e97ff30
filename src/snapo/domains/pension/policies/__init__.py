"""Policies for the weights of a fund: the network, classical ones, and closed forms.

All decide within `limits.AllocationLimits`: weights in bounds and groups, swaps with collateral.
"""
