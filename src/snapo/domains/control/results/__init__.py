"""The parts of a run that only control has."""
