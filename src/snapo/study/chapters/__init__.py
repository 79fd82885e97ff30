"""The chapters that every study can have: each a part of the run and a section of its report.

A domain names those that it wants in its study and in its report; it adds its own to them.
"""
