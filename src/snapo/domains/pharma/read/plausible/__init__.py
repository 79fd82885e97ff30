"""Conditions on a complete case, and numbers that are impossible or implausible."""
