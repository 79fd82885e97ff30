"""The kernel of a rollout: its functions, and the rows of memory that they read and write.

`kernel.emit` writes the whole module. `context` is shared by all of its functions, `sweep` one
direction of a phase, `noise` the draws, `shared` the tables that all paths share.
"""
