"""The statement of a problem: a simulator of one path, inputs, scenarios, objective, policy.

`problem.Problem` binds them into one object, which engines, checker and solver take. Nothing here
simulates a path or trains.
"""
