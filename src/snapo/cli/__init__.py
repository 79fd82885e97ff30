"""The `snapo` command: `main` reads the arguments and answers at once, `commands` prints results."""
