"""What a user's code reads beside its arguments: programs that were compiled before follow it."""
