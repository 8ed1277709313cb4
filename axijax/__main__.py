"""`python -m axijax` is the command line."""

import sys

from axijax.app.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
