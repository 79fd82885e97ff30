"""The chapters that every study can have; each is a part of the run and a section of its report.

A domain lists those in its study and its report, and adds its own chapters.
"""
