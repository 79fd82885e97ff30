"""The chapters of results that only a controlled plant has."""
