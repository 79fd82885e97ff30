"""A case's tables as records: every mistake is named with its file and key."""
