"""Gradients of arrays that all paths share: sums over lanes, steps and blocks, kept in float64.

A matrix's gradient is a sum of outer products. Adding each to memory would cost a load and a store
per multiply-add, so both factors of some tens of steps are kept and multiplied as small matrices,
tile by tile in registers; only then are the lanes added up. Vectors use the same rows.
"""
