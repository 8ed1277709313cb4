"""`python -m axijax` is the command line."""

import sys

from axijax.cli import main

if __name__ == "__main__":
    sys.exit(main())
