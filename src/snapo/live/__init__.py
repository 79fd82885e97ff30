"""The live page: inputs of a run are moved, and its trained policy is valued again."""
