"""The command line as a module, if no script is on the path: python -m snapo."""

import sys

from snapo.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
