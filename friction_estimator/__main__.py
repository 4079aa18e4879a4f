"""`python -m friction_estimator`."""

import sys

from friction_estimator.cli.main import program

if __name__ == "__main__":
    sys.exit(program())
