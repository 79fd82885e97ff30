"""The `snapo` command: `main` reads the arguments, `commands` prints the answers."""
