"""`python -m tests.fuzzing`, from the folder of the checkout."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # as pytest does

from fuzzing.campaign import main

if __name__ == "__main__":
    sys.exit(main())
