"""The `snapo` command: `main` reads the arguments and answers at once, `commands` does the work."""
