"""The settings, the state and the remedies of a training; its loop is `snapo.solver.train`.

`settings.resolve_auto` chooses the numbers that a user left open and `progress` is the state of a
run. Each other file is a remedy: scaled features, clipped adjoints, windows of a long horizon,
several starts, decisions drawn at random.
"""
