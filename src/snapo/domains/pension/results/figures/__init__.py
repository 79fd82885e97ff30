"""The figures that an actuary knows already: the model's own beside them."""
