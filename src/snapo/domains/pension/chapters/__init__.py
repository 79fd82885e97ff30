"""The questions that only a pension fund answers, each with its section of the report."""
