"""`python -m fieldmap` is the `fieldmap` command."""

import sys

from fieldmap.cli import main

if __name__ == "__main__":
    sys.exit(main())
