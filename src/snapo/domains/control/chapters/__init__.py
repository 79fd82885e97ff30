"""The questions that only a controlled plant answers."""
