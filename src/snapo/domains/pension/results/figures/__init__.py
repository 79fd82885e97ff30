"""The figures that an actuary knows already: next to the model's own."""
