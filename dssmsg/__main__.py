"""`python -m dssmsg`."""

import sys

from dssmsg.cli import main

if __name__ == "__main__":
    sys.exit(main())
