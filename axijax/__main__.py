"""`python -m axijax` is the command line."""

from axijax.cli import main

if __name__ == "__main__":
    main()
