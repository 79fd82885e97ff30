"""The kernel of a rollout: its functions, and the rows of memory that they read and write."""
