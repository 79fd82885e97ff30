"""The questions to a storage run: each file has its measure, its result and its sections."""
