"""How a result came about: times, and versions of all that had a part in it."""
