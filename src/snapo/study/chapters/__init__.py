"""The chapters that every study can have: each a part of the run and a section of its report."""
