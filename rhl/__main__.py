"""`python -m rhl`: the command line."""

import sys

from rhl.app.cli import main

if __name__ == "__main__":
    sys.exit(main())
