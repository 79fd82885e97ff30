"""Batches that differ: capability, design space, proven ranges, estimation."""
