"""What a case as a whole must keep, and numbers that cannot be, or are not likely."""
