"""The objects that a user's code reads in addition to its arguments; compiled programs depend on
them."""
