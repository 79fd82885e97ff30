"""Rules for orders: the trained rule and the classical rules."""
