"""What a user's code reads in addition to its arguments: programs that were compiled before follow
it."""
