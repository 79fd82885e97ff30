"""The figures of the model, next to those that an actuary has already."""
